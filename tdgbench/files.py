"""Files: open what others made as data, within limits; write files and folders whole or not at all; lock.

Permissions of what is written follow the umask.
"""

from __future__ import annotations

import glob
import hashlib
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path

from filelock import FileLock, Timeout

MB = 2**20
SYNC_ONCE = 2000  # files of a folder from which on all disks are flushed once, and not each file
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def opened(path: Path, most: int | None = None, inside: Path | None = None) -> BufferedReader:
    """Open a file that others may have made, to read it. Nothing else in tdgbench opens one.

    most: bytes that it may have; None: any number. inside: folder that it must lie in, once links are followed.
    Raises ValueError, without reading, for what is no regular file, leads elsewhere or is larger, and FileNotFoundError
    where there is nothing. The message names no file: the caller knows its place.
    """
    with _in_words():
        target = path.resolve()
        if inside is not None and not target.is_relative_to(inside.resolve()):
            raise ValueError(f"it leads out of its folder, to {target}")
        _check_kind(target.stat())  # before it is opened, which may block or change a device
        file = os.fdopen(os.open(target, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb")
    found = os.fstat(file.fileno())  # of what was opened, whatever lies there by now
    try:
        _check_kind(found)
        if most is not None and found.st_size > most:
            raise ValueError(f"it has {in_mb(found.st_size)}, more than {in_mb(most)}")
    except ValueError:
        file.close()
        raise
    return file


def content_of(path: Path, most: int | None = None, inside: Path | None = None) -> bytes:
    """Return the bytes of a file. Raises as `opened`."""
    with opened(path, most, inside) as file, _in_words():
        return file.read(os.fstat(file.fileno()).st_size)  # and no more, should it grow


def sha256_of(path: Path, inside: Path | None = None) -> str:
    """Return SHA-256 of a file's content, read piece by piece. Raises as `opened`."""
    with opened(path, inside=inside) as file, _in_words():
        return hashlib.file_digest(file, "sha256").hexdigest()


def in_mb(size: int) -> str:
    """Return a size in words.

    >>> in_mb(3 * MB), in_mb(100)
    ('3 MB', '100 bytes')
    """
    return f"{size / MB:,.0f} MB" if size >= MB else f"{size} bytes"


def _check_kind(found: os.stat_result) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        raise ValueError(f"it is {KINDS.get(kind, 'no file')}, not a regular file")


@contextmanager
def _in_words() -> Iterator[None]:
    """Turn an error of the system into ValueError; what is not there stays FileNotFoundError."""
    try:
        yield
    except FileNotFoundError:
        raise
    except OSError as error:  # a name that is too long, a folder without permission
        raise ValueError(f"it cannot be read: {error.strerror or error}") from error
    except RuntimeError as error:  # pathlib's of links in a circle
        raise ValueError("it cannot be read: too many levels of symbolic links") from error


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to (hidden, beside `path`, same suffix); rename it to `path` at the end.

    An error removes the partial file and leaves `path` untouched.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path} cannot be written: {path.parent} is no folder")
    # a number of the process alone is that of another one in another container, or on another machine
    part = path.with_name(f".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    with named_errors(path):
        try:
            yield part
            to_disk(part)
            part.replace(path)
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
    _names_to_disk(path.parent)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder to fill (hidden, beside `folder`); put it in the place of `folder` at the end.

    An error removes the partial folder and leaves `folder` untouched. The old content goes only once the new one is in
    its place; after a kill at any moment, `finish_replacement` leaves one of them there. The caller must hold a lock on
    `folder`.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    finish_replacement(folder)
    part = _hidden(folder, str(os.getpid()))
    with named_errors(folder):
        part.mkdir()  # not tempfile.mkdtemp, whose folders are private to the user whatever the umask
        try:
            yield part
            _whole_to_disk(part)
            put_in_place(part, folder)
        finally:
            shutil.rmtree(part, ignore_errors=True)


def put_in_place(content: Path, folder: Path) -> None:
    """Replace a folder by another one beside it, whose content is complete. The caller must hold a lock on `folder`."""
    content.replace(_hidden(folder, "new"))
    finish_replacement(folder)


def finish_replacement(folder: Path) -> None:
    """Finish what a killed process began in `whole_folder`: put its complete new content in place, remove the rest.

    The caller must hold a lock on `folder`. Raises OSError if a folder cannot be renamed; no content is lost then.
    """
    new, old = _hidden(folder, "new"), _hidden(folder, "old")
    if os.path.lexists(new):
        if os.path.lexists(folder):
            _remove(old)
            folder.replace(old)
        try:
            new.replace(folder)
        except OSError:
            with suppress(OSError):
                old.replace(folder)
            raise
        _names_to_disk(folder.parent)
    elif os.path.lexists(old) and not os.path.lexists(folder):
        old.replace(folder)
    for leftover in folder.parent.glob(f"{glob.escape(_hidden(folder, '').name)}*"):
        _remove(leftover)


@contextmanager
def named_errors(path: Path) -> Iterator[None]:
    """Add the path to an error of the system that names no file, as one of a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def _whole_to_disk(folder: Path) -> None:
    """Flush a folder's files and their names to the disk; many of them by one call for the whole system."""
    places = [(Path(place), files) for place, _, files in os.walk(folder)]
    if sum(len(files) for _, files in places) > SYNC_ONCE and hasattr(os, "sync"):
        os.sync()
        return
    for place, files in places:
        for name in files:
            to_disk(place / name)
        _names_to_disk(place)


def to_disk(path: Path) -> None:
    """Flush a file to the disk, so that a power failure cannot leave its name on an empty file."""
    with path.open("r+b") as file, named_errors(path):
        os.fsync(file.fileno())


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8), whole or not at all."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def _hidden(folder: Path, what: str) -> Path:
    """Name what `whole_folder` keeps beside a folder: `new` is complete, `old` is replaced, a number is partial."""
    return folder.with_name(f".{folder.name}.part-{what}")


def _remove(path: Path) -> None:
    """Remove a file or a folder, as far as possible."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _names_to_disk(folder: Path) -> None:
    """Flush the names in a folder to the disk, where the file system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def file_lock(path: Path) -> Iterator[bool]:
    """Try to lock a file; yield False at once if another process holds it.

    Raises OSError, with the path and the remedy, if the file cannot be made.
    """
    lock = FileLock(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        yield False
        return
    except OSError as error:
        what = f"{error.strerror or error}: no lock can be made here; remove what is in its place, or make it writable"
        raise OSError(error.errno, what, str(error.filename or path)) from error
    try:
        yield True
    finally:
        lock.release()
