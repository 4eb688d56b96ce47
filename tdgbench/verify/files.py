"""Pictures of every test view among the files of a cell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import PurePosixPath

from tdgbench.bench import masks

MUST = ("renders", "targets")
MAY = ("renders_rgb", "targets_rgb")  # of test views with an RGB image
ALONE = (masks.FOLDER,)  # of test views with masked pixels; their share in the record shows if one is missing


def picture_problems(names: Iterable[str], views: list[str]) -> Iterator[str]:
    """Pictures that a test view lacks, and pictures of no test view. names: of the cell's files."""
    expected, there = {f"{view}.png" for view in views}, set(names)
    for folder in (*MUST, *MAY, *ALONE):
        found = {PurePosixPath(name).name for name in there if PurePosixPath(name).parent.as_posix() == folder}
        yield from (f"{folder}/{name} is of no test view" for name in sorted(found - expected))
        needed = expected if folder in MUST else _partners(there, folder) if folder in MAY else found
        yield from (f"{folder}/{name} is missing" for name in sorted((needed & expected) - found))


def _partners(names: set[str], folder: str) -> set[str]:
    """Names of the pictures in the other one of `renders_rgb` and `targets_rgb`."""
    (other,) = set(MAY) - {folder}
    return {PurePosixPath(name).name for name in names if PurePosixPath(name).parent.as_posix() == other}
