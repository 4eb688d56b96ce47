"""COLMAP's text files, also as people write them. Layout: COLMAP's src/colmap/scene/reconstruction_io_text.cc.

COLMAP ends every line, so a file with its header and an unfinished last line is cut.
"""

from __future__ import annotations

import codecs
import math
import re
from array import array
from collections.abc import Callable, Iterator, Sized
from pathlib import Path

import numpy as np

from tdgbench.scenes.colmap.tables import OBSERVED, CameraEntry, DamagedModelError, ImageEntry, Points, camera_models
from tdgbench.scenes.inputs import read_bytes

COMMENT = ("", "#")  # first characters of lines that are no rows
HEADER = b"# Number of "  # COLMAP's, not that of other writers
COUNTED = re.compile(HEADER + rb"\w+: (\d{1,18})\b")
HEADER_SIZE = 1000  # bytes at a file's beginning that hold it
OF_NUMBERS = b"0123456789+-.eEinfaINFA \t"  # characters of a line of 2-D points
LARGEST_ID = 2**53  # of a point, which float64 holds
MOST_PX = 2  # of what is a quaternion, and not the first of some 2-D points


def _lines(path: Path, raw: bytes) -> Iterator[tuple[int, str]]:
    """Number the lines that are neither empty nor comments. Raises SceneError if the file is cut or not UTF-8."""
    lines = raw.removeprefix(codecs.BOM_UTF8).splitlines()
    if HEADER in raw[:HEADER_SIZE] and not raw.endswith((b"\n", b"\r")):
        raise DamagedModelError(path, f"its last line, {len(lines)}, has no end")
    for number, line in enumerate(lines, start=1):
        try:
            text = line.decode().strip()
        except UnicodeDecodeError as error:
            raise DamagedModelError(path, f"line {number} is not UTF-8", ", or save it as UTF-8") from error
        if text[:1] not in COMMENT:
            yield number, text


def _complete(path: Path, raw: bytes, rows: Sized) -> None:
    """Raise DamagedModelError if COLMAP's header counts more rows: a file that is cut between two rows."""
    counted = COUNTED.search(raw[:HEADER_SIZE])
    if counted is not None and int(counted[1]) > len(rows):
        what = f"its header counts {int(counted[1])} rows, but it has {len(rows)}"
        raise DamagedModelError(path, what, "; if rows were removed on purpose, correct the header")


def _numbers(words: list[str], kind: Callable[[str], float] = float) -> list:
    """Return numbers as COLMAP reads them, which knows neither 1_0 nor other alphabets' digits. Raises ValueError."""
    odd = [word for word in words if "_" in word or not word.isascii()]
    if odd:
        raise ValueError(f"{odd[0]!r} is no number")
    return list(map(kind, words))


def read_cameras(path: Path) -> list[CameraEntry]:
    """Read the rows of cameras.txt. Raises SceneError."""
    raw, sizes, cameras = read_bytes(path), dict(camera_models().values()), []
    for number, text in _lines(path, raw):
        try:
            camera_id, model, width, height, *params = text.split()
            if len(params) != sizes.get(model):
                raise ValueError(f"{model} with {len(params)} parameters is no camera model")
            size = _numbers([camera_id, width, height], int)
            cameras.append(CameraEntry(size[0], model, size[1], size[2], tuple(_numbers(params))))
        except ValueError as error:
            raise DamagedModelError(path, f"line {number} is no camera: {error}") from error
    _complete(path, raw, cameras)
    return cameras


def read_images(path: Path, observed: bool = False) -> list[ImageEntry]:
    """Read the rows of images.txt, with their 2-D points if `observed`. Raises SceneError.

    The line after an image may hold its 2-D points, be empty, or lack.
    """
    raw, images, is_image = read_bytes(path), list[ImageEntry](), False
    for number, text in _lines(path, raw):
        follows, points = is_image, _points2d(text, observed)
        if is_image := points is None:
            try:
                images.append(_image(text))
            except ValueError as error:
                what = f"line {number} is no image: {error}; nor is it of 2-D points, with X, Y and POINT3D_ID of each"
                raise DamagedModelError(path, what) from error
        elif not follows or _could_be_image(text):
            what = "can be an image or 2-D points" if follows else "has 2-D points, but there is no image before it"
            raise DamagedModelError(path, f"line {number} {what}", ", or give each image a name with a letter")
        elif observed:
            images[-1] = images[-1]._replace(points=points)
    _complete(path, raw, images)
    return images


def _image(text: str) -> ImageEntry:
    """Read an image; its name is the rest of the line, with the spaces in it. Raises ValueError."""
    *words, name = text.split(maxsplit=9)
    if len(words) < 9:
        raise ValueError(f"it has {len(words) + 1} words, not 10 or more")
    ids = _numbers([words[0], words[8]], int)
    return ImageEntry(ids[0], _numbers(words[1:5]), _numbers(words[5:8]), ids[1], name)


def _could_be_image(text: str) -> bool:
    """Return whether a line of numbers can be an image: one whose name is lacking or of numbers."""
    words = text.split(maxsplit=9)
    return len(words) > 8 and (words[0] + words[8]).isdigit() and math.hypot(*map(float, words[1:5])) <= MOST_PX


def _points2d(text: str, observed: bool) -> np.ndarray | None:
    """Return a line's 2-D points, (N,) OBSERVED; a few of them unless `observed`; None if it has none."""
    words = text.split()
    if len(words) % 3 or text.encode().translate(None, OF_NUMBERS):
        return None
    try:
        rows = np.array(list(map(float, words if observed else words[:9]))).reshape(-1, 3)
    except ValueError:
        return None
    points, ids = np.empty(len(rows), OBSERVED), rows[:, 2]
    if not (np.abs(ids) <= LARGEST_ID).all() or (ids % 1).any():
        return None
    points["xy"], points["point"] = rows[:, :2], ids.astype(np.int64).view(np.uint64)  # -1: no point
    return points


def read_points(path: Path) -> Points:
    """Read the rows of points3D.txt. Raises SceneError."""
    raw = read_bytes(path)
    ids, xyz, colors, lengths, images = array("Q"), array("d"), array("B"), array("q"), array("I")
    for number, text in _lines(path, raw):
        words = text.split()  # the track, from the ninth on, has an image and its 2-D point in turn
        try:
            if "_" in text or not text.isascii():
                raise ValueError("it has a word that is no number")
            if len(words) < 8 or len(words) % 2:
                raise ValueError(f"it has {len(words)} words, not 8 and 2 for each image of its track")
            ids.append(int(words[0]))
            xyz.extend(map(float, words[1:4]))
            colors.extend(map(int, words[4:7]))
            float(words[7])
            images.extend(map(int, words[8::2]))
            lengths.append(len(words) // 2 - 4)
        except (ValueError, OverflowError) as error:
            why = f"a number is out of its range ({error})" if isinstance(error, OverflowError) else error
            raise DamagedModelError(path, f"line {number} is no point: {why}") from error
    _complete(path, raw, ids)
    points = np.asarray(xyz).reshape(-1, 3), np.asarray(colors).reshape(-1, 3)
    return Points(np.asarray(ids), *points, np.asarray(lengths), np.asarray(images))
