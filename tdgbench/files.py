"""Write files and folders whole or not at all. Their permissions follow the umask."""

from __future__ import annotations

import glob
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to (hidden, beside `path`, same suffix); rename it to `path` at the end.

    An error removes the partial file and leaves `path` untouched.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path} cannot be written: {path.parent} is no folder")
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
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
    its place; after a kill at any moment, `settle` leaves one of them there. The caller must hold a lock on `folder`.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    finish_replacement(folder)
    part = _hidden(folder, str(os.getpid()))
    with named_errors(folder):
        part.mkdir()  # not tempfile.mkdtemp, whose folders are private to the user whatever the umask
        try:
            yield part
            for place, _, files in os.walk(part):
                for name in files:
                    to_disk(Path(place, name))
                _names_to_disk(Path(place))
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
