"""Write files and folders whole or not at all. Their permissions follow the umask."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to (hidden, beside `path`, same suffix); rename it to `path` at the end.

    An error removes the partial file and leaves `path` untouched.
    """
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield part
        to_disk(part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder to fill (hidden, beside `folder`); put it in the place of `folder` at the end.

    An error removes the partial folder and leaves `folder` untouched. The old content goes only once the new one is
    complete. Leftovers of killed processes are removed: the caller must hold a lock on `folder`.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    for leftover in folder.parent.glob(f".{folder.name}.part-*"):
        shutil.rmtree(leftover, ignore_errors=True)
    part = folder.with_name(f".{folder.name}.part-{os.getpid()}")
    old = folder.with_name(f".{folder.name}.part-old")
    part.mkdir()  # not tempfile.mkdtemp, whose folders are private to the user whatever the umask
    try:
        yield part
        for path in part.rglob("*"):
            if path.is_file():
                to_disk(path)
        if folder.exists():
            folder.replace(old)
        part.replace(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def to_disk(path: Path) -> None:
    """Flush a file to the disk, so that a power failure cannot leave its name on an empty file."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8), whole or not at all."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
