"""Read the files of a cell, which may be anything by now: regular files inside it, up to a size, with clear errors."""

from __future__ import annotations

import csv
import io
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.files import MB, content_of, opened

MAX_TEXT = 4 * MB  # of a record or a table; a record of 1 000 test views has 0.7. In memory JSON takes 25 times as much
MAX_CAMERAS = 16 * MB  # of a list of cameras; 10 000 views have 7
MOST_ROWS = 100_000  # of a table
MAX_PICTURE = 256 * MB  # of a PNG file
MOST_PIXELS = 2**22  # of a view of a cell: three times those of large thermal cameras; a check takes 250 bytes for each


def read_text(path: Path, most: int = MAX_TEXT) -> str:
    """Read a UTF-8 text file of a cell. most: bytes that it may have.

    Raises ValueError for anything else, FileNotFoundError where there is nothing.
    """
    try:
        return content_of(path, most, inside=path.parent).decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8 text (byte {error.start})") from error


def read_table(path: Path) -> list[list[str]]:
    """Return rows of a CSV file, all as long as the first one. Raises ValueError for anything else."""
    try:
        rows = list(csv.reader(io.StringIO(table_text(path), newline=""), strict=True))
    except csv.Error as error:
        raise ValueError(str(error)) from error
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise ValueError(f"row {number} has {len(row)} fields, the first one {len(rows[0])}")
    return rows


def table_text(path: Path) -> str:
    """Return the text of a CSV file. Raises ValueError for too many rows, and as `read_text`."""
    text = read_text(path)
    if max(text.count("\n"), text.count("\r")) > MOST_ROWS:
        raise ValueError(f"it has more than {MOST_ROWS:,} rows")
    return text


def read_picture(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """Return a picture in a folder of a cell, (H, W, 1) or (H, W, 3) uint8. size: width, height that it must have, px.

    The size in its header is compared before anything is decoded. Raises ValueError for anything but such a picture,
    FileNotFoundError where there is nothing.
    """
    with opened(path, MAX_PICTURE, inside=path.parents[1]) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of large pictures; their size is checked here
        try:
            with Image.open(file, formats=("PNG",)) as picture:
                _check_header(picture, size)
                values = np.asarray(picture)
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
    if picture.width * picture.height > MOST_PIXELS:
        raise ValueError(f"{picture.width}×{picture.height} px are too many")
    if picture.mode not in ("L", "RGB"):
        raise ValueError(f"it is of mode {picture.mode}, not 8-bit gray or RGB")
