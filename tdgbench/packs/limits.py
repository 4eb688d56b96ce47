"""What a pack may hold, and how much: known kinds of files, under plain names, within limits that are checked first."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection
from pathlib import PurePosixPath
from typing import BinaryIO

from tdgbench.bench import cameras, plan
from tdgbench.bench.paths import CELL_FILE
from tdgbench.bench.read_files import MAX_CAMERAS, MAX_PICTURE, MAX_TEXT
from tdgbench.bench.record import FILE
from tdgbench.files import MB, in_mb
from tdgbench.scenes.inputs import check_view_name

MOST_MANIFEST = 16 * MB  # a hundred thousand files
MOST_FILES = 100_000  # 140 cells of 40 test views have 25 000
MOST_CELLS = 1500  # the paper's tables with five seeds have 140
MOST_BYTES = 2**20 * MB  # unpacked
LARGEST_RATIO = 100  # of unpacked to packed bytes; models of one channel and SH degree 0 have some 10
HARMLESS = 64 * MB  # unpacked, that are never too many
MOST_DIRECTORY = 64 * MB  # of the zip file's own list, which is read at once
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
    return MAX_CAMERAS if path.name == cameras.FILE else kinds.get(path.suffix, MOST_BYTES)


def check_amount(names: Collection[str], unpacked: int, packed: int) -> None:
    """Raise ValueError for more files, cells or bytes than a pack of so many bytes may hold."""
    cells = sum(name.endswith(f"/{FILE}") for name in names)
    for count, most, what in ((len(names), MOST_FILES, "files"), (cells, MOST_CELLS, "cells")):
        if count > most:
            raise ValueError(f"it holds {count:,} {what}, more than {most:,}")
    most = min(MOST_BYTES, max(LARGEST_RATIO * packed, HARMLESS))
    if unpacked > most:
        raise ValueError(f"of {in_mb(packed)}, it would unpack to {in_mb(unpacked)}, more than {in_mb(most)}")


def check_directory(file: BinaryIO) -> None:
    """Raise ValueError for a zip file whose list of members is too long to be read.

    Its size is in the last record of the file (PKWARE's APPNOTE, 4.3.14 and 4.3.16).
    """
    size = file.seek(0, 2)
    file.seek(max(0, size - 2**16 - 98))
    tail = file.read()
    end = tail.rfind(b"PK\x05\x06")
    sizes = [struct.unpack_from("<I", tail, end + 12)[0]] if 0 <= end <= len(tail) - 22 else []
    if sizes == [2**32 - 1] and end >= 76 and tail[end - 76 : end - 72] == b"PK\x06\x06":
        sizes = [struct.unpack_from("<Q", tail, end - 36)[0]]
    if sizes and sizes[0] > MOST_DIRECTORY:
        raise ValueError(f"its list of files has {in_mb(sizes[0])}, more than {in_mb(MOST_DIRECTORY)}")
