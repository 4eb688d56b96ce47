"""Read zip files of others: what they state is checked before a member is read, and no more than that is unpacked."""

from __future__ import annotations

import io
import stat
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from tdgbench.files import MB, in_mb, opened

LARGEST_RATIO = 100  # of unpacked to packed bytes; images have 1 to 2, models of one channel and SH degree 0 some 10
HARMLESS = 64 * MB  # unpacked, that are never too many
MOST_BYTES = 2**20 * MB  # unpacked
MOST_MEMBERS = 200_000  # ten times those of ten scenes with 500 views of four files
MOST_LIST = 32 * MB  # of the list of members, which is read at once; each has some 150 bytes
PIECE = MB // 4  # that is unpacked at once; pieces of 1 MB take 1.6 times as long
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # of bzip2, 46 bytes are 45 MB, which zipfile unpacks at once


class Member(NamedTuple):
    """A file or folder (its name ends in /) of a zip file.

    size: in bytes, as stated. chunks: yields its content, no more than that; raises ValueError if it is damaged.
    """

    size: int
    chunks: Callable[[], Iterator[bytes]]


class _Bounded(io.BufferedReader):
    """A zip file for zipfile, which believes the size that it states of its list of members."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > MOST_LIST:
            raise ValueError(f"its list of files has {in_mb(size)}, more than {in_mb(MOST_LIST)}")
        return super().read(size)


@contextmanager
def opened_zip(path: Path) -> Iterator[dict[str, Member]]:
    """Yield the members of a zip file by name.

    Raises ValueError, which says why and names no file, for what is no zip file; for two members of one name, links,
    devices, encrypted members and compression other than deflate; for more than MOST_MEMBERS, and for more than
    LARGEST_RATIO times the file's bytes. Raises FileNotFoundError where there is nothing.
    """
    with opened(path) as file:
        packed = file.seek(0, io.SEEK_END)
        with _in_words():  # many programs do not flag that names are UTF-8
            archive = zipfile.ZipFile(_Bounded(file), metadata_encoding="utf-8")  # type: ignore[arg-type]
        with archive:
            members = {one.filename: one for one in archive.infolist()}
            if len(members) < len(archive.infolist()):
                raise ValueError("it holds two files of one name")
            if len(members) > MOST_MEMBERS:
                raise ValueError(f"it holds {len(members):,} files, more than {MOST_MEMBERS:,}")
            most = min(MOST_BYTES, max(LARGEST_RATIO * packed, HARMLESS))
            if (unpacked := sum(one.file_size for one in members.values())) > most:
                raise ValueError(f"of {in_mb(packed)}, it would unpack to {in_mb(unpacked)}, more than {in_mb(most)}")
            for one in members.values():
                _check(one)
            yield {name: Member(one.file_size, partial(_chunks, archive, one)) for name, one in members.items()}


def safe_path(name: str) -> PurePosixPath:
    """Return the path of a member below its top. Raises ValueError for a name that leads elsewhere.

    >>> safe_path("./lion/rgb/1.jpg")
    PurePosixPath('lion/rgb/1.jpg')
    """
    path = PurePosixPath(name)
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts or "\\" in name:
        raise ValueError(f"the name {name!r} leads out of its folder")
    if not name.isprintable():
        raise ValueError(f"the name {name!r} has characters that cannot be printed")
    return path


def _check(one: zipfile.ZipInfo) -> None:
    mode = stat.S_IFMT(one.external_attr >> 16)  # 0 if no Unix has made the archive
    if mode not in (0, stat.S_IFDIR if one.is_dir() else stat.S_IFREG):
        raise ValueError(f"{one.filename!r} is no regular file")
    if one.flag_bits & 1:  # PKWARE's APPNOTE 4.4.4
        raise ValueError(f"{one.filename!r} is encrypted")
    if one.compress_type not in METHODS:
        raise ValueError(f"{one.filename!r} is compressed in another way than by deflate")


def _chunks(archive: zipfile.ZipFile, one: zipfile.ZipInfo) -> Iterator[bytes]:
    with _in_words(), archive.open(one) as content:
        while chunk := content.read(PIECE):
            yield chunk


@contextmanager
def _in_words() -> Iterator[None]:
    """Turn zipfile's errors, which are of many kinds, into ValueError."""
    try:
        yield
    except (MemoryError, ValueError):
        raise
    except Exception as error:
        raise ValueError(f"it is damaged: {error or type(error).__name__}") from error
