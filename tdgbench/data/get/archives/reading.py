"""Members of zip and tar archives, and their bytes."""

from __future__ import annotations

import bz2
import errno
import gzip
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

from tdgbench.data.get.errors import BadFileError

SUFFIXES = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
UNREADABLE = (".7z", ".rar", ".tar.zst", ".zipx")  # archives that only other programs read
LARGEST_READ = 2**24  # bytes at once: headers of tar files are read into memory, whatever size they claim
_ENCRYPTED, _UTF_8 = 0x1, 0x800  # bits of a zip member's flags (PKWARE's APPNOTE 4.4.4)
_DAMAGED = (zipfile.BadZipFile, tarfile.TarError, gzip.BadGzipFile, lzma.LZMAError, zlib.error, EOFError, ValueError,
            NotImplementedError, RuntimeError, OverflowError, LookupError, struct.error)  # fmt: skip
_NO_DISK = (None, errno.EINVAL)  # errors of bz2, and of a jump to before the beginning of a file
_COMPRESSED: dict[bytes, Callable[[IO[bytes]], Any]] = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ\x00": lzma.open,
}


class Member(NamedTuple):
    """A member of an archive as it describes itself.

    kind: "file", "folder", or a noun for what is refused. size: of the unpacked file in bytes, as declared. handle:
    of the library.
    """

    name: str
    kind: str
    size: int
    handle: Any


class Archive(ABC):
    """An open archive."""

    @abstractmethod
    def members(self) -> Iterator[Member]:
        """All members in their order; nothing is read ahead."""

    @abstractmethod
    def content(self, member: Member) -> AbstractContextManager[IO[bytes]]:
        """The bytes of a file."""


class ZipArchive(Archive):
    def __init__(self, file: zipfile.ZipFile) -> None:
        self._zip = file

    def members(self) -> Iterator[Member]:
        for info in self._zip.infolist():
            kind, name = _zip_kind(info), info.orig_filename
            if not info.flag_bits & _UTF_8:  # zipfile has read the bytes as code page 437; programs write UTF-8 as well
                try:
                    name = name.encode("cp437").decode("utf-8")
                except UnicodeError:
                    kind = "a name of unknown encoding"
            yield Member(name, kind, info.file_size, info)

    def content(self, member: Member) -> AbstractContextManager[IO[bytes]]:
        return self._zip.open(member.handle)


class TarArchive(Archive):
    """A tar file; `stream` is its content, decompressed."""

    def __init__(self, file: tarfile.TarFile, stream: IO[bytes]) -> None:
        self._file, self._stream = file, stream

    def members(self) -> Iterator[Member]:
        for info in self._file:
            yield Member(info.name, _tar_kind(info), info.size, info)
        if len(self._stream.read(LARGEST_READ)) == LARGEST_READ:  # to the end, where the sum of the compressed data is
            raise tarfile.ReadError(f"{LARGEST_READ} bytes or more follow the last member")

    def content(self, member: Member) -> AbstractContextManager[IO[bytes]]:
        content = self._file.extractfile(member.handle)
        assert content is not None  # it is a file
        return content


class _ShortReads:
    """A binary file that refuses to read much at once, as a tar header of gigabytes would have it do."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= LARGEST_READ:
            raise tarfile.ReadError(f"a header of {size} bytes")
        return self._file.read(size)

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()


def is_archive(name: str) -> bool:
    """Whether a file's name is that of an archive which can be unpacked here.

    >>> is_archive("Lion.ZIP"), is_archive("lion.tar.gz"), is_archive("lion.7z")
    (True, True, False)
    """
    return name.lower().endswith(SUFFIXES)


def stem(name: str) -> str:
    """Name of an archive without its suffix.

    >>> stem("lion.tar.gz")
    'lion'
    """
    suffix = max((s for s in SUFFIXES if name.lower().endswith(s)), key=len, default="")
    return name[: len(name) - len(suffix)]


@contextmanager
def opened(path: Path) -> Iterator[Archive]:
    """Open an archive; its content decides what it is, not its name.

    Raises BadFileError if it is damaged or no archive.
    """
    with ExitStack() as stack:
        with readable(path):
            archive = _open(stack.enter_context(path.open("rb")), stack)
        yield archive


def _open(file: IO[bytes], stack: ExitStack) -> Archive:
    magic = file.read(6)
    file.seek(0)
    if magic.startswith(b"PK"):
        return ZipArchive(stack.enter_context(zipfile.ZipFile(file)))
    decompress = next((opener for start, opener in _COMPRESSED.items() if magic.startswith(start)), None)
    plain = stack.enter_context(decompress(file)) if decompress else file
    reader = cast(IO[bytes], _ShortReads(plain))
    return TarArchive(stack.enter_context(tarfile.open(fileobj=reader, mode="r:", encoding="utf-8")), reader)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn the errors of the libraries about damaged archives into BadFileError; a full disk stays an OSError."""
    try:
        yield
    except _DAMAGED as error:
        raise _damaged(path, error) from error
    except OSError as error:
        if error.errno not in _NO_DISK:
            raise
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> BadFileError:
    reason = str(error) or type(error).__name__
    return BadFileError(f"{path} cannot be unpacked: {reason}; --force downloads it again, or unpack it by hand")


def _zip_kind(info: zipfile.ZipInfo) -> str:
    if info.flag_bits & _ENCRYPTED:
        return "encrypted"
    mode = stat.S_IFMT(info.external_attr >> 16)  # 0 if no Unix has made the archive
    if info.is_dir() and mode in (0, stat.S_IFDIR):
        return "folder"
    return {0: "file", stat.S_IFREG: "file", stat.S_IFLNK: "a symbolic link"}.get(mode, "a special file")


def _tar_kind(info: tarfile.TarInfo) -> str:
    kinds = {
        tarfile.DIRTYPE: "folder",
        tarfile.SYMTYPE: "a symbolic link",
        tarfile.LNKTYPE: "a hard link",
        tarfile.CHRTYPE: "a device",
        tarfile.BLKTYPE: "a device",
        tarfile.FIFOTYPE: "a FIFO",
    }
    return "file" if info.isreg() and not info.issparse() else kinds.get(info.type, "a special file")
