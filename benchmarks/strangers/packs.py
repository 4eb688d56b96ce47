"""Zip files that only look like packs, or whose entries lie: names, kinds, sizes, methods, manifests."""

from __future__ import annotations

import json
import stat
import zipfile
from random import Random
from typing import NamedTuple

from benchmarks.strangers.cases import OF_PACKS, Case, of_pack
from benchmarks.strangers.honest import WITHOUT_PARTS, Honest
from benchmarks.strangers.values import ELSEWHERE, TARGETS, TEXTS, flipped, hostile_json
from benchmarks.strangers.watch import MARK
from benchmarks.strangers.zips import FIELDS, Entry, bomb_of, with_field, zipped

MB = 2**20
NAMES = (
    "../x", "/etc/x", "a/../../x", "C:\\x", "a\\..\\..\\x", "x" * 300, "x" * 65_000, "a/" * 200 + "x", "a\0b", "a\nb",
    "\x1b[2Jx", ".", "..", "./a", "a//b", " ", "cells", f"{WITHOUT_PARTS}/renders", f"{WITHOUT_PARTS}/record.json/x",
    "experiment.json/x", "manifest.json", "MANIFEST.JSON", "\u202egnp.x", "con", "a:b", "~", "é" * 120, "tmp/x",
)  # fmt: skip
CODE = ("evil.py", "sitecustomize.py", "torch.py", "numpy/__init__.py", "x.pth", "x.so", "methods/evil.py",
        f"{WITHOUT_PARTS}/__init__.py", f"{MARK}.py", "conf/config.yaml", ".hydra/config.yaml", "run.sh")  # fmt: skip
FILES = ("record.json", "model.ply", "renders/view000.png", "views.csv", "log.csv", "cameras.json", "parts.pt", "x.txt")
KINDS = {"link": stat.S_IFLNK, "FIFO": stat.S_IFIFO, "device": stat.S_IFCHR, "folder": stat.S_IFDIR,
         "socket": stat.S_IFSOCK}  # fmt: skip
PAYLOAD = f"import os\n{MARK} = 1\nos.system('touch {MARK}')\n".encode()
MANY = (f"{WITHOUT_PARTS}/notes/%d.txt", "cells/a/b/c/d/seed%d/record.json", "a/" * 40 + "%d", "%d.py")
METHODS = {"bzip2": zipfile.ZIP_BZIP2, "LZMA": zipfile.ZIP_LZMA, "deflate": zipfile.ZIP_DEFLATED}


class Zip(NamedTuple):
    """A zip file. must_fail: whether `verify` and `unpack` have to refuse it."""

    what: str
    content: bytes
    must_fail: bool = False


def zip_cases(rng: Random, honest: Honest) -> Case:
    """A zip file that a tool is to read as a pack."""
    how = rng.choice((entry, manifest, field, damage, bomb, many))
    made: Zip = how(rng, honest)
    return of_pack(honest, made.content, made.what, rng.choice(sorted(OF_PACKS)), must_fail=made.must_fail)


def _entries(honest: Honest) -> list[Entry]:
    return [Entry(name, content) for name, content in honest.pack.items()]


def entry(rng: Random, honest: Honest) -> Zip:
    """An entry more, or a replaced one: of another kind, of a hostile name, of code, twice, compressed otherwise."""
    entries = _entries(honest)
    at = rng.randint(0, len(entries) - 1)
    how = rng.choice(("kind", "name", "code", "twice", "method", "unlisted", "lost"))
    if how == "kind":
        kind, target = rng.choice(sorted(KINDS)), rng.choice((*ELSEWHERE, "record.json", "."))
        entries[at] = entries[at]._replace(kind=KINDS[kind], content=target.encode())
        return Zip(f"{entries[at].name} is a {kind} to {target}", zipped(entries), must_fail=True)
    if how in ("name", "code"):
        name = rng.choice(NAMES if how == "name" else CODE)
        entries.insert(rng.choice((0, len(entries))), Entry(name, PAYLOAD))
        return Zip(f"an entry {name[:80]!r}", zipped(entries))
    if how == "twice":
        return Zip(f"{entries[at].name} twice", zipped([*entries, entries[at]._replace(content=b"x")]), must_fail=True)
    if how == "method":
        method = rng.choice(sorted(METHODS))
        entries[at] = entries[at]._replace(method=METHODS[method])
        return Zip(f"{entries[at].name} by {method}", zipped(entries))
    if how == "unlisted":
        name = rng.choice(NAMES)
        entries.append(Entry(name, PAYLOAD, in_manifest=False))
        return Zip(f"{name[:80]!r} is not in the manifest", zipped(entries), must_fail=name != "manifest.json")
    lost = entries.pop(at)
    return Zip(f"{lost.name} is not there", zipped(entries))


def manifest(rng: Random, honest: Honest) -> Zip:
    """A hostile manifest of honest files."""
    entries = _entries(honest)
    if rng.random() < 0.5:
        field = rng.choice(("experiment", "version"))
        value = rng.choice((*TEXTS, *TARGETS, "x" * 255, "é" * 130))
        return Zip(f"manifest: {field} = {value[:60]!r}", zipped(entries, {field: value}))
    listed = {e.name: {"size": len(e.content), "sha256": "0" * 64} for e in entries[:3]}
    honest_text = json.dumps({"experiment": "a", "version": "0", "files": listed, "format": 1}).encode()
    text, what, _ = hostile_json(rng, honest_text)
    return Zip(f"manifest: {what}", zipped(entries, text), must_fail=True)


def field(rng: Random, honest: Honest) -> Zip:
    """A directory that lies about an entry."""
    name = rng.choice(("manifest.json", *honest.pack))
    stated = rng.choice(sorted(FIELDS))
    value = rng.choice((0, 1, 9, 12, 14, 93, 99, -1, -2, 2**31))
    content = with_field(zipped(_entries(honest)), name, stated, value)
    return Zip(f"the directory states {stated} {value} of {name}", content)


def damage(rng: Random, honest: Honest) -> Zip:
    """Flipped bytes, something before and behind the archive."""
    content = flipped(rng, zipped(_entries(honest)))
    around = rng.choice((b"", PAYLOAD, b"\x7fELF", b"PK\x05\x06" + b"\0" * 18, b"\0" * MB))
    return Zip(f"flipped bytes, {len(around)} bytes around", around + content + around)


def bomb(rng: Random, honest: Honest) -> Zip:
    """A file of some hundred MB that compresses to a thousandth, alone or several times."""
    size, copies = rng.choice(((1200, 1), (120, 10), (60, 1)))
    name = rng.choice(FILES)
    fill = rng.choice((b"\0", b"[") if size > 60 else (b"\0", b"[", b"\n", b"1,", b'"'))
    copied = [f"{WITHOUT_PARTS}/{name}", *(f"cells/a/b/c/d/seed{n}/{name}" for n in range(1, copies))]
    entries = [one for one in _entries(honest) if one.name not in copied]
    bombs = [Entry(name, b"", bomb=bomb_of(size * MB, fill)) for name in copied]
    return Zip(f"{copies} × {size} MB of {fill!r} as {name}", zipped([*entries, *bombs]))


def many(rng: Random, honest: Honest) -> Zip:
    """Thousands of tiny files."""
    count, name = rng.choice((2_000, 30_000)), rng.choice(MANY)
    return Zip(f"{count} files {name}", zipped([*_entries(honest), *(Entry(name % n, b"{}") for n in range(count))]))
