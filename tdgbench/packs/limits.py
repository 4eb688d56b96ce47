"""What a pack may hold, and how much: known kinds of files, under plain names, within limits that are checked first."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import PurePosixPath

from tdgbench.archives import MOST_BYTES
from tdgbench.cells import plan
from tdgbench.cells.paths import CAMERAS_FILE, CELL_FILE, RECORD_FILE
from tdgbench.cells.read_files import MAX_CAMERAS, MAX_PICTURE, MAX_TEXT
from tdgbench.files import MB
from tdgbench.scenes.inputs import check_view_name

MOST_MANIFEST = 16 * MB  # a hundred thousand files
MOST_FILES = 100_000  # 140 cells of 40 test views have 25 000
MOST_CELLS = 1500  # the paper's tables with five seeds have 140
NAME = r"[\w][\w .,=+~()-]{0,99}"  # of an experiment: letters, digits and signs that no shell reads between quotes
FOLDER = re.compile(r"[\w,=+~-][\w.,=+~-]*")  # of a cell; `folder_name` makes no others
LEVELS = 5  # of folders of a cell below `cells`: method, data set, scene, initial points, seed


def check_place(name: str) -> None:
    """Raise ValueError unless a relative path is that of a file that packs hold."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or path.as_posix() != name:
        raise ValueError(f"{name!r} is no place in the pack")
    folders, file = path.parts[1 : LEVELS + 1], "/".join(path.parts[LEVELS + 1 :])
    is_of_cell = path.parts[0] == "cells" and len(folders) == LEVELS and all(map(FOLDER.fullmatch, folders))
    if name != plan.FILE and not (is_of_cell and CELL_FILE.fullmatch(file)):
        raise ValueError(f"{name!r} is no file of a cell")
    if path.suffix == ".png":
        check_view_name(path.stem, "it")


def most_bytes(name: str) -> int:
    """Return how many bytes a file may have, by its kind."""
    path, kinds = PurePosixPath(name), {".json": MAX_TEXT, ".csv": MAX_TEXT, ".png": MAX_PICTURE}
    return MAX_CAMERAS if path.name == CAMERAS_FILE else kinds.get(path.suffix, MOST_BYTES)


def check_amount(names: Collection[str]) -> None:
    """Raise ValueError for more files or cells than a pack may hold."""
    cells = sum(name.endswith(f"/{RECORD_FILE}") for name in names)
    for count, most, what in ((len(names), MOST_FILES, "files"), (cells, MOST_CELLS, "cells")):
        if count > most:
            raise ValueError(f"it holds {count:,} {what}, more than {most:,}")
