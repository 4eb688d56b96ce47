"""Unpack zip and tar archives; refuse those that would write elsewhere, or more than they should."""

from __future__ import annotations

import bz2
import errno
import gzip
import io
import lzma
import math
import os
import re
import shutil
import stat
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, Any, BinaryIO, NamedTuple

from tdgbench.data.get.sources import BadFileError
from tdgbench.data.progress import amount
from tdgbench.files import opened
from tdgbench.text import shortened

ARCHIVE = re.compile("(.+?)[.](zip|tar|tar[.]gz|tgz|tar[.]bz2|tbz2|tar[.]xz|txz)", re.IGNORECASE)
JUNK = {"__MACOSX", "Thumbs.db", "desktop.ini"}  # what file managers leave in archives
LARGEST_RATIO = 100.0  # of unpacked to packed bytes; images have 1 to 2, float arrays with filler up to some 20
HARMLESS = 2**26  # unpacked bytes that are never too many
MOST_MEMBERS = 200_000  # ten times those of ten scenes with 500 views of four files, more than any data set here has
LARGEST_INDEX = 2**25  # bytes of a zip archive's list of members, of which MOST_MEMBERS have some 150 each
PIECE = 2**16  # bytes that are read at once
SMALL_PIECE = 64  # of bzip2 and LZMA in zip archives: zipfile unpacks it as a whole, and bzip2 has 45 MB in 46 bytes
_DECODERS: dict[bytes, Callable[[BinaryIO], Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
# Errors of gzip and bz2; of a jump to before the beginning of a file; of two members with one name; of a long name.
_NO_DISK = (None, errno.EINVAL, errno.EEXIST, errno.ENOTDIR, errno.ENAMETOOLONG)


class RefusedError(ValueError):
    """An archive or a name that could do harm; the message says how."""


class Member(NamedTuple):
    """A member of an archive as it describes itself.

    kind: "file", "folder", or a noun for what is refused. size: of the unpacked file in bytes, as declared.
    """

    name: str
    kind: str
    size: int
    open: Callable[[], IO[bytes] | None]
    piece: int = PIECE  # bytes to read at once


class _Bounded(io.BufferedReader):
    """A file for readers that believe the sizes in it: it refuses to be read behind `most`, or many bytes at once."""

    def __init__(self, raw: Any, most: float, at_once: int) -> None:
        super().__init__(raw)
        self.most, self.at_once, self.last = most, at_once, b""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size == -1:
            size = self.at_once  # zipfile reads the last bytes of an archive so
        if size > self.at_once:
            raise RefusedError(f"a header in it states a size of more than {amount(self.at_once)}")
        self._check(self.tell())
        self.last = super().read(size)
        return self.last

    def seek(self, target: int, whence: int = os.SEEK_SET, /) -> int:
        self._check(target)
        return super().seek(target, whence)

    def _check(self, place: int) -> None:
        if place > self.most:
            raise RefusedError(f"it has more than {amount(int(self.most))}, headers included")


def unpack(archive: Path, folder: Path) -> list[PurePosixPath]:
    """Unpack an archive into a folder; return the paths of its files, without hidden files and file managers' ones.

    The first bytes tell the kind of archive, not its name. Raises BadFileError for a damaged archive, for links,
    devices and encrypted members, for names that lead elsewhere, for too many members, and for more than 100 times the
    archive's bytes, as soon as the members declare them. Raises OSError for a full disk.
    """
    try:
        return list(_unpack(archive, folder))
    except RefusedError as error:
        raise BadFileError(f"{archive} is refused: {error}; nothing of it is in place") from error
    except Exception as error:  # the decoders raise many kinds
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno not in _NO_DISK):
            raise
        reason = shortened(str(error) or type(error).__name__)
        raise BadFileError(
            f"{archive} cannot be unpacked: {reason}; --force downloads it again, or unpack it by hand"
        ) from error


def safe_path(name: str) -> PurePosixPath:
    """Return the path of a member of an archive or listing below its top. Raises RefusedError for any other name.

    >>> safe_path("./lion/rgb/1.jpg")
    PurePosixPath('lion/rgb/1.jpg')
    """
    path = PurePosixPath(name)
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts or "\\" in name:
        raise RefusedError(f"the name {name!r} leads out of its folder")
    if not name.isprintable():
        raise RefusedError(f"the name {name!r} has characters that cannot be printed")
    return path


def stem(name: str) -> str | None:
    """Return the name of an archive without its suffix; None for a file that cannot be unpacked here.

    >>> stem("Lion.ZIP"), stem("lion.tar.gz"), stem("lion.7z")
    ('Lion', 'lion', None)
    """
    match = ARCHIVE.fullmatch(name)
    return match and match[1]


def is_junk(path: PurePosixPath) -> bool:
    """Return whether a file is hidden or a file manager's.

    >>> is_junk(PurePosixPath("__MACOSX/lion/._1.jpg")), is_junk(PurePosixPath("lion/1.jpg"))
    (True, False)
    """
    return any(part.startswith(".") or part in JUNK for part in path.parts)


def _unpack(archive: Path, folder: Path) -> Iterator[PurePosixPath]:
    with opened(archive) as file:
        start, packed, total = file.read(6), file.seek(0, os.SEEK_END), 0
        most = max(LARGEST_RATIO * packed, HARMLESS)
        file.seek(0)
        members = _zip_members(file) if start.startswith(b"PK") else _tar_members(file, start, most)
        for count, member in enumerate(members, start=1):
            total += member.size
            if total > most:
                raise RefusedError(f"of {amount(packed)}, it would unpack to more than {amount(int(most))}")
            if count > MOST_MEMBERS:
                raise RefusedError(f"it has more than {MOST_MEMBERS} members")
            if member.kind not in ("file", "folder"):
                raise RefusedError(f"its member {member.name!r} is {member.kind}")
            path = safe_path(member.name)
            if member.kind == "folder" or not path.parts or is_junk(path):
                continue
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            content = member.open()
            assert content is not None  # a regular file of a tar archive has content
            with content, (folder / path).open("xb") as out:
                shutil.copyfileobj(content, out, member.piece)  # no more than declared: the readers see to it
            yield path


def _zip_members(file: BinaryIO) -> Iterator[Member]:
    bounded = _Bounded(file, math.inf, LARGEST_INDEX)
    with zipfile.ZipFile(bounded, metadata_encoding="utf-8") as archive:  # many programs do not flag UTF-8 in names
        for info in archive.infolist():
            piece = SMALL_PIECE if info.compress_type in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA) else PIECE
            opening = partial(_zip_open, archive, info, piece)
            yield Member(info.filename, _zip_kind(info), info.file_size, opening, piece)


def _zip_open(archive: zipfile.ZipFile, info: zipfile.ZipInfo, piece: int) -> IO[bytes]:
    content = archive.open(info)
    content.MIN_READ_SIZE = min(piece, content.MIN_READ_SIZE)  # type: ignore[attr-defined]
    return content


def _tar_members(file: BinaryIO, start: bytes, most: float) -> Iterator[Member]:
    decoder = next((decoder for magic, decoder in _DECODERS.items() if start.startswith(magic)), None)
    stream = _Bounded(decoder(file) if decoder else file, 2 * most, PIECE)  # twice, for headers and filling
    with tarfile.open(fileobj=stream, mode="r:", encoding="utf-8") as archive:
        for info in archive:
            kind = "folder" if info.isdir() else "file" if info.isreg() else "a special file"
            kind = "a link" if info.issym() or info.islnk() else kind
            kind = "of negative size" if info.size < 0 else kind
            yield Member(info.name, kind, info.size, partial(archive.extractfile, info))
        if stream.last.strip(b"\0") or not stream.last:
            raise ValueError("it ends early, or the header of a member is damaged")
        while stream.read(PIECE):  # to the end, where the sum of the compressed data is
            pass


def _zip_kind(info: zipfile.ZipInfo) -> str:
    if info.flag_bits & 0x1:  # PKWARE's APPNOTE 4.4.4
        return "encrypted"
    mode = stat.S_IFMT(info.external_attr >> 16)  # 0 if no Unix has made the archive
    if info.is_dir() and mode in (0, stat.S_IFDIR):
        return "folder"
    return {0: "file", stat.S_IFREG: "file", stat.S_IFLNK: "a link"}.get(mode, "a special file")
