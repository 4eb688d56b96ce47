"""A case: strangers' files, the command that reads them, and what is wrong with how it ends."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Literal, NamedTuple

from benchmarks.strangers.honest import WITHOUT_PARTS, Files, Honest
from benchmarks.strangers.server import MOST_BYTES, Outcome, Server
from benchmarks.strangers.values import MARKUP
from benchmarks.strangers.zips import Entry, zipped

MOST_WRITTEN = 1000.0  # MB; a case has some MB
THEIRS, PACK, OUT = "theirs", "pack.zip", "out"
OF_PACKS = {
    "verify": ("verify", PACK), "compare": ("compare", PACK, "honest.zip", "--out", OUT),
    "site": ("site", PACK, OUT), "score": ("score", PACK, OUT), "unpack": ("unpack", PACK, OUT),
}  # fmt: skip
OF_FOLDERS = {
    "verify": ("verify", THEIRS), "tables": ("tables", THEIRS), "score": ("score", THEIRS, OUT),
    "view": ("view", f"{THEIRS}/{WITHOUT_PARTS}", "--export", "out.html"),
    "pack": ("pack", THEIRS, "--out", "again.zip", "--keep-paths"),
}  # fmt: skip
NO_MEMORY = re.compile(r"MemoryError|Unable to allocate|not enough memory|bad_alloc|can't allocate|out of memory")
CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
MOST_PRINTED = 300_000  # characters


class Special(NamedTuple):
    """What is no regular file. target: of a link."""

    kind: Literal["link", "fifo", "folder"]
    target: str = ""


@dataclass(frozen=True)
class Case:
    """what: is hostile, in words. files: by path below the case's folder. must_fail: status 0 would be false."""

    what: str
    files: dict[str, bytes | Special] = field(repr=False)
    words: tuple[str, ...]
    must_fail: bool = False


def of_pack(honest: Honest, pack: bytes, what: str, tool: str, *, must_fail: bool = False) -> Case:
    """Return the case of a tool that reads a zip file. must_fail: whether `verify` and `unpack` have to refuse it."""
    files: dict[str, bytes | Special] = {PACK: pack}
    if tool == "compare":
        files["honest.zip"] = (honest.folder / "honest.zip").read_bytes()
    return Case(what, files, OF_PACKS[tool], must_fail and tool in ("verify", "unpack"))


def of_folder(files: Files, what: str, tool: str, *, must_fail: bool = False) -> Case:
    """Return the case of a tool that reads a results folder. must_fail: whether `verify` has to find something."""
    return Case(
        what, {f"{THEIRS}/{n}": data for n, data in files.items()}, OF_FOLDERS[tool], must_fail and tool == "verify"
    )


def reading(rng: Random, honest: Honest, files: Files, what: str, *, must_fail: bool = False) -> Case:
    """A case in which a tool reads a pack with these files, whose manifest is right, or a folder with them.

    must_fail: whether `verify` has to find something.
    """
    if rng.random() < 0.5:
        return of_folder(files, what, rng.choice(sorted(OF_FOLDERS)), must_fail=must_fail)
    tool = rng.choice(sorted(OF_PACKS))
    pack = zipped([Entry(name, content) for name, content in files.items()])
    return of_pack(honest, pack, what, tool, must_fail=must_fail and tool == "verify")


def write(case: Case, folder: Path) -> None:
    """Write the files of a case into a new folder. Names that no file can have are left out."""
    folder.mkdir(parents=True)
    for name, content in case.files.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, bytes):
                path.write_bytes(content)
            elif content.kind == "link":
                path.symlink_to(content.target)
            elif content.kind == "fifo":
                os.mkfifo(path)
            else:
                path.mkdir()
        except (OSError, ValueError):
            continue


def run_case(server: Server, case: Case, folder: Path, kept: Path | None = None) -> tuple[Outcome, list[str]]:
    """Run a case in a folder, which is removed; return its problems, too. kept: a folder for one that has some."""
    try:
        write(case, folder)
        outcome = server.run(list(case.words), folder)
        found = problems_of(case, outcome)
        pages = [path for path in folder.rglob("*.html") if path.is_file()]
        live = [path for path in pages if MARKUP in path.read_text("utf-8", "replace")]
        found += [f"{page.relative_to(folder)} holds live markup" for page in live[:1]]
        if found and kept is not None:
            shutil.rmtree(kept, ignore_errors=True)
            write(case, kept)
            text = "\n".join([repr(case), f"tdgbench {' '.join(case.words)}", *found, outcome.error, outcome.output])
            (kept / "case.txt").write_text(text, encoding="utf-8", errors="backslashreplace")
        return outcome, found
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def problems_of(case: Case, outcome: Outcome) -> list[str]:
    """Return what is wrong with the end of a case, in words."""
    found = [f"violation: {what}" for what in outcome.violations]
    if outcome.error:
        places = re.findall(r'File "[^"]*/(tdgbench/[^"]+|methods/[^"]+)", line (\d+)', outcome.error)
        where = ":".join(places[-1]) if places else "elsewhere"
        found.append(f"unexpected error: {outcome.error.strip().splitlines()[-1][:200]} ({where})")
    if "Traceback (most recent" in outcome.output:
        found.append("prints a traceback")
    if outcome.timed_out:
        found.append(f"does not end within {outcome.seconds:.0f} s")
    elif outcome.signal:
        found.append(f"is ended by signal {outcome.signal}")
    elif outcome.status not in (0, 1, 2):
        found.append(f"ends with status {outcome.status!r}")
    if outcome.mb * 2**20 > MOST_BYTES or NO_MEMORY.search(outcome.output + outcome.error):
        found.append(f"wants more than {MOST_BYTES / 2**30:.0f} GB of memory")
    if outcome.written_mb > MOST_WRITTEN:
        found.append(f"writes {outcome.written_mb:.0f} MB")
    if case.must_fail and outcome.status == 0:
        found.append("ends with status 0")
    if control := CONTROLS.search(outcome.output):
        found.append(f"prints the control character {control[0]!r}")
    if outcome.printed > MOST_PRINTED:
        found.append(f"prints {outcome.printed} characters")
    return found
