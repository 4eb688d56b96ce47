"""COLMAP's text files. Layout: COLMAP's src/colmap/scene/reconstruction_io_text.cc.

COLMAP ends every line, so a file with its header and an unfinished last line is cut.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sized
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tdgbench.scenes.colmap.tables import REMEDY, CameraEntry, DamagedModelError, ImageEntry, Points, camera_models
from tdgbench.scenes.inputs import read_bytes

NEWLINE = b"\n"
COMMENT = ("", "#")  # first characters of lines that are no rows
HEADER = b"# Number of "  # COLMAP's, not that of other writers
COUNTED = re.compile(HEADER + rb"\w+: (\d{1,18})\b")
HEADER_SIZE = 1000  # bytes at a file's beginning that hold it


def _text_lines(path: Path) -> list[str]:
    """Return lines of a whole file. Raises SceneError if it is cut or not UTF-8."""
    raw = read_bytes(path)
    if HEADER in raw[:HEADER_SIZE] and not raw.endswith(NEWLINE):
        raise DamagedModelError(path, f"its last line, {raw.count(NEWLINE) + 1}, has no end")
    try:
        return raw.decode().split("\n")
    except UnicodeDecodeError as error:
        line = raw.count(NEWLINE, 0, error.start) + 1
        raise DamagedModelError(path, f"line {line} is not UTF-8") from error


def _complete(path: Path, rows: Sized) -> None:
    """Raise DamagedModelError if COLMAP's header counts more rows: a file that is cut between two rows."""
    counted = COUNTED.search(read_bytes(path)[:HEADER_SIZE])
    if counted is not None and int(counted[1]) > len(rows):
        raise DamagedModelError(
            path,
            f"its header counts {int(counted[1])} rows, but it has {len(rows)}",
            f"{REMEDY}; if rows were removed on purpose, correct the header",
        )


@contextmanager
def _naming(path: Path, number: int, what: str) -> Iterator[None]:
    """Turn errors of reading a line into DamagedModelError. what: the row that it should be."""
    try:
        yield
    except (ValueError, LookupError, OverflowError) as error:
        raise DamagedModelError(path, f"line {number} is no {what}: {error}") from error


def _numbers(words: list[str], kind: Callable[[str], float] = float) -> list:
    """Return numbers as COLMAP reads them, which knows neither 1_0 nor other alphabets' digits. Raises ValueError."""
    odd = [word for word in words if "_" in word or not word.isascii()]
    if odd:
        raise ValueError(f"{odd[0]!r} is no number")
    return list(map(kind, words))


def read_cameras(path: Path) -> list[CameraEntry]:
    """Read the rows of cameras.txt. Raises SceneError."""
    sizes, cameras = dict(camera_models().values()), []
    for number, text in enumerate(_text_lines(path), start=1):
        if text.lstrip()[:1] in COMMENT:
            continue
        with _naming(path, number, "camera"):
            camera_id, model, width, height, *params = text.split()
            if len(params) != sizes.get(model):
                raise ValueError(f"{model} with {len(params)} parameters is no camera model")
            size = _numbers([camera_id, width, height], int)
            cameras.append(CameraEntry(size[0], model, size[1], size[2], tuple(_numbers(params))))
    _complete(path, cameras)
    return cameras


def read_images(path: Path) -> list[ImageEntry]:
    """Read the rows of images.txt: two lines each, the second of 2-D points or empty. Raises SceneError."""
    images = []
    lines = enumerate(_text_lines(path), start=1)
    for number, text in lines:
        if text.lstrip()[:1] in COMMENT:
            continue
        with _naming(path, number, "image"):
            image_id, qw, qx, qy, qz, x, y, z, camera_id, name = text.split(maxsplit=9)
            ids = _numbers([image_id, camera_id], int)
            images.append(ImageEntry(ids[0], _numbers([qw, qx, qy, qz]), _numbers([x, y, z]), ids[1], name.strip()))
        number, points = next(lines, (number + 1, ""))
        if len(points.split()) % 3:
            raise DamagedModelError(path, f"line {number} has {len(points.split())} words, not 3 for each 2-D point")
    _complete(path, images)
    return images


def read_points(path: Path) -> Points:
    """Read the rows of points3D.txt. Raises SceneError."""
    ids: list[int] = []
    xyz: list[float] = []
    colors: list[int] = []
    lengths: list[int] = []
    images: list[int] = []
    for number, text in enumerate(_text_lines(path), start=1):
        words = text.split()  # the track, from the ninth on, has an image and its 2-D point in turn
        if not words or words[0][0] == "#":
            continue
        try:  # and no _naming, since models have millions of points
            if "_" in text or not text.isascii():
                raise ValueError("it has a word that is no number")
            ids.append(int(words[0]))
            xyz += map(float, words[1:4])
            colors += map(int, words[4:7])
            float(words[7])
            images += map(int, words[8::2])
            lengths.append(len(words[8::2]))
        except (ValueError, IndexError) as error:
            raise DamagedModelError(path, f"line {number} is no point: {error}") from error
    _complete(path, ids)
    try:
        return Points(
            np.array(ids, np.uint64),
            np.array(xyz, np.float64).reshape(-1, 3),
            np.array(colors, np.uint8).reshape(-1, 3),
            np.array(lengths, np.int64),
            np.array(images, np.uint32),
        )
    except OverflowError as error:
        raise DamagedModelError(path, f"an id, a color or a track is out of its range ({error})") from error
