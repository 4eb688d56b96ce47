"""Refuse archives that would write outside of their folder, or more than they should."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from tdgbench.data.get.archives.reading import Archive, Member, readable
from tdgbench.data.get.errors import BadFileError
from tdgbench.data.get.progress import amount
from tdgbench.data.get.remote import first_clash, safe_path

JUNK = {"__MACOSX", "Thumbs.db", "desktop.ini"}  # what file managers leave in archives


class Limits(NamedTuple):
    """What an archive may hold.

    ratio: of unpacked to packed bytes; images have 1 to 2, float arrays with filler up to some 20. harmless: unpacked
    bytes that are never too many. files: number of members.
    """

    ratio: float = 100.0
    harmless: int = 2**26
    files: int = 200_000


LIMITS = Limits()


class File(NamedTuple):
    """A file to unpack; `path` is relative to the archive's top."""

    path: PurePosixPath
    member: Member


def checked_files(archive: Archive, path: Path, limits: Limits = LIMITS) -> list[File]:
    """Files of an archive, hidden ones and file managers' left out. Nothing is unpacked.

    Raises BadFileError for links, devices, encrypted members, names that lead elsewhere, names that a file system could
    confuse, and for more bytes than `limits` allow; the sizes are those that the archive declares.
    """
    with readable(path):
        files = list(_files(archive, path, limits))
    clash = first_clash(file.path for file in files)
    if clash is not None:
        raise _refused(path, f"it has two members that a file system may take for one: {str(clash)!r}")
    return [file for file in files if not is_junk(file.path)]


def _files(archive: Archive, path: Path, limits: Limits) -> Iterator[File]:
    """All files; the first member that is not allowed ends the reading."""
    most = max(limits.ratio * path.stat().st_size, limits.harmless)
    total = 0
    for number, member in enumerate(archive.members(), 1):
        if member.kind not in ("file", "folder"):
            raise _refused(path, f"its member {member.name!r} is {member.kind}")
        place = safe_path(member.name)
        if isinstance(place, str):
            raise _refused(path, f"the name of its member {member.name!r} {place}")
        total += member.size
        if total > most:
            raise _refused(path, f"of {amount(path.stat().st_size)}, it would unpack to more than {amount(int(most))}")
        if number > limits.files:
            raise _refused(path, f"it has more than {limits.files} members")
        if member.kind == "file" and place.parts:
            yield File(place, member)


def is_junk(path: PurePosixPath) -> bool:
    """Whether a file is hidden or a file manager's.

    >>> is_junk(PurePosixPath("__MACOSX/lion/._1.jpg")), is_junk(PurePosixPath("lion/1.jpg"))
    (True, False)
    """
    return any(part.startswith(".") or part in JUNK for part in path.parts)


def size(files: Iterable[File]) -> int:
    """Declared bytes of files."""
    return sum(file.member.size for file in files)


def _refused(path: Path, why: str) -> BadFileError:
    return BadFileError(f"{path} is refused: {why}; nothing of it was unpacked")
