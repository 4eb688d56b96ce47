"""Hashes of the files of a cell that a record names, and files that do not fit them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from tdgbench.bench.reading import check_regular
from tdgbench.bench.record import FILE

OF_TIMES = ("log.csv",)  # hold times, so that they differ between equal trainings


def cell_files(folder: Path) -> dict[str, Path]:
    """Return everything below a cell's folder but its record and folders, by relative path. Links are not followed."""
    found = [path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir()]
    return {path.relative_to(folder).as_posix(): path for path in found if path != folder / FILE}


def sha256(path: Path) -> str:
    """Return SHA-256 of a file's content, read piece by piece."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hashes(folder: Path) -> dict[str, str]:
    """Return SHA-256 of every file below a cell's folder but its record, by relative path."""
    return {name: sha256(path) for name, path in cell_files(folder).items()}


def hashes_of_content(recorded: dict[str, str]) -> dict[str, str]:
    """Return those of a record's hashes that equal trainings share.

    >>> hashes_of_content({"model.ply": "ab", "log.csv": "cd"})
    {'model.ply': 'ab'}
    """
    return {name: value for name, value in recorded.items() if name not in OF_TIMES}


def file_problems(folder: Path, recorded: dict[str, str]) -> Iterator[str]:
    """Yield files that are missing, unknown to the record, changed, or no files; those are never opened."""
    actual = cell_files(folder)
    yield from (f"{name} is missing" for name in sorted(set(recorded) - set(actual)))
    yield from (f"{name} is not in the record" for name in sorted(set(actual) - set(recorded)))
    for name in sorted(set(actual) & set(recorded)):
        try:
            check_regular(actual[name])
            if sha256(actual[name]) != recorded[name]:
                yield f"{name} has changed"
        except (OSError, ValueError) as error:
            yield f"{name} cannot be read: {error}"
