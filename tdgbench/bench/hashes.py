"""Hashes of the files of a cell that a record names."""

from __future__ import annotations

import hashlib
from pathlib import Path

from tdgbench.bench.record import FILE

OF_TIMES = ("log.csv",)  # hold times, so that they differ between equal trainings


def cell_files(folder: Path) -> dict[str, Path]:
    """Everything below a cell's folder but its record and folders, by relative path. Links are not followed."""
    found = [path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir()]
    return {path.relative_to(folder).as_posix(): path for path in found if path != folder / FILE}


def sha256(path: Path) -> str:
    """SHA-256 of a file's content, read piece by piece."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below a cell's folder but its record, by relative path."""
    return {name: sha256(path) for name, path in cell_files(folder).items()}


def hashes_of_content(recorded: dict[str, str]) -> dict[str, str]:
    """Those of a record's hashes that equal trainings share.

    >>> hashes_of_content({"model.ply": "ab", "log.csv": "cd"})
    {'model.ply': 'ab'}
    """
    return {name: value for name, value in recorded.items() if name not in OF_TIMES}
