"""Files of zip and tar archives; archives that would write elsewhere, or more than they should, are refused."""

from __future__ import annotations

import errno
import lzma
import re
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, Any, NamedTuple

from tdgbench.data.get.sources import BadFileError
from tdgbench.data.progress import amount
from tdgbench.text import shortened

ARCHIVE = re.compile("(.+?)[.](zip|tar|tar[.]gz|tgz|tar[.]bz2|tbz2|tar[.]xz|txz)", re.IGNORECASE)
JUNK = {"__MACOSX", "Thumbs.db", "desktop.ini"}  # what file managers leave in archives
LONGEST_REASON = 200  # characters
LARGEST_RATIO = 100.0  # of unpacked to packed bytes; images have 1 to 2, float arrays with filler up to some 20
HARMLESS = 2**26  # unpacked bytes that are never too many
_ENCRYPTED = 0x1  # bit of a zip member's flags (PKWARE's APPNOTE 4.4.4)
_DAMAGED = (zipfile.BadZipFile, tarfile.TarError, lzma.LZMAError, zlib.error, EOFError, ValueError,
            NotImplementedError, RuntimeError, OverflowError, LookupError)  # fmt: skip
# Errors of gzip and bz2; of a jump to before the beginning of a file; of two members with one name.
_NO_DISK = (None, errno.EINVAL, errno.EEXIST, errno.ENOTDIR)


class Member(NamedTuple):
    """A member of an archive as it describes itself.

    kind: "file", "folder", or a noun for what is refused. size: of the unpacked file in bytes, as declared.
    """

    name: str
    kind: str
    size: int
    open: Callable[[], Any]


class File(NamedTuple):
    """A file to unpack. path: relative to the archive's top. content: to be read before the next file is asked for."""

    path: PurePosixPath
    size: int
    content: IO[bytes]


def archive_files(path: Path) -> Iterator[File]:
    """Return files of an archive in its order, hidden ones and file managers' left out.

    Its content decides what it is, not its name. Raises BadFileError for links, devices and
    encrypted members, for names that lead elsewhere, and for more than 100 times its bytes, as soon as it declares
    them. To be called within `readable`, which names the errors of damaged archives.
    """
    packed, total = path.stat().st_size, 0
    most = max(LARGEST_RATIO * packed, HARMLESS)
    with ExitStack() as stack:
        for member in _members(path, stack):
            if member.kind not in ("file", "folder"):
                raise _refused(path, f"its member {member.name!r} is {member.kind}")
            try:
                place = safe_path(member.name)
            except ValueError as error:
                raise _refused(path, f"the name of its member {member.name!r} {error}") from error
            total += member.size
            if total > most:
                raise _refused(path, f"of {amount(packed)}, it would unpack to more than {amount(int(most))}")
            if member.kind == "file" and place.parts and not is_junk(place):
                with member.open() as content:
                    yield File(place, member.size, content)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn errors of unpacking a damaged archive into BadFileError; a full disk stays an OSError."""
    try:
        yield
    except (*_DAMAGED, OSError) as error:
        if isinstance(error, OSError) and error.errno not in _NO_DISK:
            raise
        reason = shortened(str(error) or type(error).__name__, LONGEST_REASON)
        raise BadFileError(
            f"{path} cannot be unpacked: {reason}; --force downloads it again, or unpack it by hand"
        ) from error


def safe_path(name: str) -> PurePosixPath:
    """Return the path of a member of an archive or listing below its top. Raises ValueError, with the reason.

    >>> safe_path("./lion/rgb/1.jpg")
    PurePosixPath('lion/rgb/1.jpg')
    """
    path = PurePosixPath(name)
    if not name.isprintable():
        raise ValueError("has characters that cannot be printed")
    if "\\" in name:
        raise ValueError("has a backslash")
    if path.is_absolute() or PureWindowsPath(name).drive:
        raise ValueError("is an absolute path")
    if ".." in path.parts:
        raise ValueError("leads out of its folder")
    return path


def stem(name: str) -> str | None:
    """Return name of an archive without its suffix; None if it is not that of an archive which can be unpacked here.

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


def _members(path: Path, stack: ExitStack) -> Iterator[Member]:
    with path.open("rb") as file:
        is_zip = file.read(2) == b"PK"
    if is_zip:  # many programs write names in UTF-8 without the flag that says so
        archive = stack.enter_context(zipfile.ZipFile(path, metadata_encoding="utf-8"))
        return (Member(m.filename, _zip_kind(m), m.file_size, partial(archive.open, m)) for m in archive.infolist())
    return _tar_members(stack.enter_context(tarfile.open(path, encoding="utf-8")))


def _tar_members(archive: tarfile.TarFile) -> Iterator[Member]:
    for info in archive:
        kind = "folder" if info.isdir() else "file" if info.isreg() else "a special file"
        kind = "a link" if info.issym() or info.islnk() else kind
        yield Member(info.name, kind, info.size, partial(archive.extractfile, info))
    assert archive.fileobj is not None
    while archive.fileobj.read(2**20):  # to the end, where the sum of the compressed data is
        pass


def _zip_kind(info: zipfile.ZipInfo) -> str:
    if info.flag_bits & _ENCRYPTED:
        return "encrypted"
    mode = stat.S_IFMT(info.external_attr >> 16)  # 0 if no Unix has made the archive
    if info.is_dir() and mode in (0, stat.S_IFDIR):
        return "folder"
    return {0: "file", stat.S_IFREG: "file", stat.S_IFLNK: "a link"}.get(mode, "a special file")


def _refused(path: Path, why: str) -> BadFileError:
    return BadFileError(f"{path} is refused: {why}; nothing of it is in place")
