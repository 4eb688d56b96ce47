"""Read the files of a cell, which may be anything by now: only regular files, up to a size, with clear errors."""

from __future__ import annotations

import csv
import io
import stat
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.scenes.inputs import KINDS
from tdgbench.scenes.validate import MAX_PIXELS

MAX_TEXT = 64 * 2**20  # bytes of a record, a table or a list of cameras


def check_regular(path: Path) -> int:
    """Return the size in bytes of a regular file, or of one that a link leads to.

    Raises ValueError for anything else, without opening it, and FileNotFoundError where there is nothing.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        raise
    except OSError as error:  # a loop of links, a name that is too long, a folder without permission
        raise ValueError(f"it cannot be read: {error.strerror}") from error
    if not stat.S_ISREG(found.st_mode):
        raise ValueError(f"it is {KINDS.get(stat.S_IFMT(found.st_mode), 'no file')}, not a regular file")
    return found.st_size


def read_text(path: Path) -> str:
    """Read a UTF-8 text file. Raises ValueError for anything else, FileNotFoundError where there is nothing."""
    if check_regular(path) > MAX_TEXT:
        raise ValueError(f"it is larger than {MAX_TEXT // 2**20} MB")
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8 text (byte {error.start})") from error
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ValueError(f"it cannot be read: {error.strerror}") from error


def read_table(path: Path) -> list[list[str]]:
    """Return rows of a CSV file, all as long as the first one. Raises ValueError for anything else."""
    try:
        rows = list(csv.reader(io.StringIO(read_text(path), newline=""), strict=True))
    except csv.Error as error:
        raise ValueError(str(error)) from error
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise ValueError(f"row {number} has {len(row)} fields, the first one {len(rows[0])}")
    return rows


def read_picture(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """Return a stored picture, (H, W, 1) or (H, W, 3) uint8. size: width and height that it must have, px.

    The size in its header is compared before anything is decoded. Raises ValueError for anything but such a picture,
    FileNotFoundError where there is nothing.
    """
    check_regular(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures; their size is checked here
            with Image.open(path, formats=("PNG",)) as picture:
                _check_header(picture, size)
                values = np.asarray(picture)
    except FileNotFoundError:
        raise
    except Exception as error:  # Pillow raises SyntaxError, struct.error, zlib.error … on damaged files
        raise ValueError(f"it is no picture: {error}") from error
    return values[..., None] if values.ndim == 2 else values


def read_named(folder: Path, name: str, size: tuple[int, int] | None = None) -> np.ndarray:
    """`read_picture` of a cell's folder, by relative path. Raises ValueError, naming it, if missing or unusable."""
    try:
        return read_picture(folder / name, size)
    except FileNotFoundError as error:
        raise ValueError(f"{name} is missing") from error
    except ValueError as error:
        raise ValueError(f"{name} cannot be read: {error}") from error


def _check_header(picture: Image.Image, size: tuple[int, int] | None) -> None:
    if size is not None and picture.size != size:
        raise ValueError(f"it is {picture.width}×{picture.height} px, its camera {size[0]}×{size[1]} px")
    if picture.width * picture.height > MAX_PIXELS:
        raise ValueError(f"{picture.width}×{picture.height} px are too many")
    if picture.mode not in ("L", "RGB"):
        raise ValueError(f"it is of mode {picture.mode}, not 8-bit gray or RGB")
