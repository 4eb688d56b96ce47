"""What once failed: each a file, and the tool that did not stand it."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable

from benchmarks.strangers.cases import Case, Special, of_folder, of_pack
from benchmarks.strangers.honest import WITH_PARTS, WITHOUT_PARTS, Honest
from benchmarks.strangers.models import CHECKPOINT, PICKLES, cell_files, in_text, ply_changes
from benchmarks.strangers.records import RECORD, fitting
from benchmarks.strangers.scenes import SCENE, TEXT_MODEL
from benchmarks.strangers.values import replaced
from benchmarks.strangers.watch import MARK
from benchmarks.strangers.zips import Entry, bomb_of, zipped

MB = 2**20
Make = Callable[[Honest], Case]


def bomb(size: int, copies: int, tool: str) -> Make:
    def make(honest: Honest) -> Case:
        zeros = bomb_of(size * MB, b"\0")
        bombs = [Entry(f"cells/a/b/c/d/seed{number}/model.ply", b"", bomb=zeros) for number in range(copies)]
        return of_pack(honest, zipped(bombs), f"{copies} × {size} MB", tool, must_fail=True)

    return make


def many(name: str, tool: str) -> Make:
    return lambda honest: of_pack(honest, zipped([Entry(name % number, b"{}") for number in range(2000)]), name, tool)


def setting(cell: str, place: str, value: object, tool: str) -> Make:
    def make(honest: Honest) -> Case:
        name = f"{cell}/{RECORD}"
        record = replaced(json.loads(honest.pack[name]), ("config", *place.split(".")), value)
        code = {f"{MARK}.py": f"{MARK} = 1\n".encode()}
        return of_folder({**honest.pack, **code, name: json.dumps(record).encode()}, f"{place} = {value}", tool)

    return make


def changed(cell: str, name: str, change: Callable[[bytes], bytes], tool: str) -> Make:
    return lambda honest: of_folder(
        fitting(honest.pack, cell, {name: change(honest.pack[f"{cell}/{name}"])}), name, tool
    )


def checkpoint(how: str) -> Make:
    def make(honest: Honest) -> Case:
        content = PICKLES[how](honest.pack[f"{WITH_PARTS}/parts.pt"])
        return Case(how, {"a.pt": content, **cell_files(honest)}, (CHECKPOINT, "a.pt", "cell"))

    return make


def scene(name: str, content: bytes | Special | Callable[[bytes], bytes], text: bool = False) -> Make:
    def make(honest: Honest) -> Case:
        files = dict(honest.scenes["3dgs"])
        if text:
            files = {path: data for path, data in files.items() if not path.endswith(".bin")}
            files |= {f"sparse/0/{path}": data.encode() for path, data in TEXT_MODEL.items()}
        new = content(files[name]) if callable(content) else content
        return Case(
            name, {f"{SCENE}/{path}": data for path, data in {**files, name: new}.items()}, ("data", "check", SCENE)
        )

    return make


def with_header(how: str) -> Callable[[bytes], bytes]:
    return lambda model: model.replace(*ply_changes(model)[how])


def doubled_rows(table: bytes) -> bytes:
    return table + b"".join(b"v%d," % n + table.splitlines()[1].partition(b",")[2] + b"\n" for n in range(200_000))


def with_count(at: int) -> Callable[[bytes], bytes]:
    return lambda content: content[:at] + struct.pack("<Q", 2**64 - 1) + content[at + 8 :]


PAST: dict[str, Make] = {
    "one file of 1200 MB": bomb(1200, 1, "verify"),
    "ten files of 120 MB": bomb(120, 10, "unpack"),
    "2000 files in deep folders": many("a/" * 40 + "%d", "unpack"),
    "2000 records, for verify": many("cells/a/b/c/d/seed%d/record.json", "verify"),
    "2000 records, for site": many("cells/a/b/c/d/seed%d/record.json", "site"),
    "a method that is any module": setting(WITH_PARTS, "method.method._target_", "turtledemo.x", "verify"),
    "a method beside the cells": setting(WITH_PARTS, "method.method._target_", f"theirs.{MARK}.x", "verify"),
    "weights elsewhere, for verify": setting(WITHOUT_PARTS, "metrics.lpips.weights", "/etc/passwd", "verify"),
    "weights elsewhere, for score": setting(WITHOUT_PARTS, "metrics.lpips.weights", "/etc/passwd", "score"),
    "a header of 50 MB": changed(WITHOUT_PARTS, "model.ply", with_header("50 MB of comments"), "verify"),
    "a model in text": changed(WITHOUT_PARTS, "model.ply", in_text, "verify"),
    "200000 rows of views.csv": changed(WITHOUT_PARTS, "views.csv", doubled_rows, "tables"),
    "deflated parts": changed(WITH_PARTS, "parts.pt", PICKLES["a deflated storage of 1200 MB"], "verify"),
    "deflated names of parts": changed(WITH_PARTS, "parts.pt", PICKLES["a deflated pickle of 1200 MB"], "verify"),
    "a checkpoint that asks for memory": checkpoint("bytearray(10**10)"),
    "a checkpoint with a large tensor": checkpoint("an empty tensor of 10¹⁰"),
    "a checkpoint that is deflated": checkpoint("a deflated storage of 1200 MB"),
    "2⁶⁴ images of a frame": scene("sparse/0/frames.bin", with_count(72)),
    "a temperature of megabytes": scene("temperature.json", b'{"min": 0, "max": [' + b"0," * 10**6 + b"0]}"),
    "a camera of number -1": scene("sparse/0/cameras.txt", b"-1 PINHOLE 32 24 30 30 16 12\n", text=True),
}
