"""COLMAP's binary files, read so that every count and length is proved against the file's size first.

Layout: COLMAP's src/colmap/scene/reconstruction_io_binary.cc; all numbers are little-endian. pycolmap's own reader
believes the counts: a file one byte short makes it allocate without end.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from pathlib import Path
from struct import Struct
from struct import error as StructError

import numpy as np

from tdgbench.scenes.colmap.tables import OBSERVED, CameraEntry, DamagedModelError, ImageEntry, Points, camera_models
from tdgbench.scenes.inputs import read_bytes

COUNT = Struct("<Q")
CAMERA = Struct("<IiQQ")
IMAGE = Struct("<I7dI")
POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("color", "u1", 3), ("error", "<f8"), ("track", "<u8")])
TRACK_ELEMENT = 8  # bytes
LONGEST_NAME = 4096  # bytes; Linux's PATH_MAX


class _Cursor:
    """A place in a file. `row` says what is being read, for messages."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at, self.row = path, read_bytes(path), 0, "the file"

    def damaged(self, what: str) -> DamagedModelError:
        return DamagedModelError(self.path, what)

    def take(self, form: Struct) -> tuple:
        first, self.at = self.at, self.at + form.size
        if self.at > len(self.data):
            raise self.damaged(f"{self.row} needs {self.at} bytes, but the file has {len(self.data)}")
        return form.unpack_from(self.data, first)

    def count(self, what: str, smallest: int) -> int:
        """Read a number of items of at least `smallest` bytes each, which the rest of the file has room for."""
        (count,) = self.take(COUNT)
        if count * smallest > len(self.data) - self.at:
            raise self.damaged(
                f"{self.row} counts {count} {what}, which need {count * smallest} bytes or more, but "
                f"{len(self.data) - self.at} of {len(self.data)} are left"
            )
        return count

    def rows(self, what: str, smallest: int):
        """Number each row of the file; afterwards, check that nothing is left over."""
        count = self.count(f"{what}s", smallest)
        for number in range(1, count + 1):
            self.row = f"{what} {number} of {count} (byte {self.at})"
            yield number
        self.end(count, what)

    def end(self, count: int, what: str) -> None:
        if self.at != len(self.data):
            raise self.damaged(f"its {count} {what}s end at byte {self.at}, but the file has {len(self.data)}")

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + LONGEST_NAME)
        if end < 0:
            raise self.damaged(f"{self.row} has a name without an end")
        raw, self.at = self.data[self.at : end], end + 1
        try:
            return raw.decode()
        except UnicodeDecodeError as error:
            raise self.damaged(f"{self.row} has the name {raw!r}, which is not UTF-8") from error


def read_cameras(path: Path) -> list[CameraEntry]:
    """Read the rows of cameras.bin. Raises SceneError."""
    file, cameras = _Cursor(path), []
    for _ in file.rows("camera", CAMERA.size):
        camera_id, model, width, height = file.take(CAMERA)
        if model not in camera_models():
            raise file.damaged(f"{file.row} has an unknown model id {model}")
        name, size = camera_models()[model]
        cameras.append(CameraEntry(camera_id, name, width, height, file.take(Struct(f"<{size}d"))))
    return cameras


def read_images(path: Path, observed: bool = False) -> list[ImageEntry]:
    """Read the rows of images.bin, with their 2-D points if `observed`, as views of the file. Raises SceneError."""
    file, images = _Cursor(path), []
    for _ in file.rows("image", IMAGE.size + 1 + COUNT.size):
        image_id, *pose, camera_id = file.take(IMAGE)
        name = file.name()
        count = file.count("2-D points", OBSERVED.itemsize)
        images.append(ImageEntry(image_id, pose[:4], pose[4:], camera_id, name))
        if observed:
            images[-1] = images[-1]._replace(points=np.ndarray(count, OBSERVED, file.data, file.at))
        file.at += OBSERVED.itemsize * count
    return images


def read_points(path: Path) -> Points:
    """Read the rows of points3D.bin. Raises SceneError."""
    file = _Cursor(path)
    count = file.count("points", POINT.itemsize)
    data, size, track = file.data, len(file.data), POINT.fields["track"][1]  # type: ignore[index]
    starts = array("q", [at := file.at])  # of rows, and their end
    try:
        for _ in range(count):  # nothing else is done point by point, since models have millions of them
            (length,) = COUNT.unpack_from(data, at + track)
            starts.append(at := at + POINT.itemsize + TRACK_ELEMENT * length)
    except (StructError, OverflowError):
        at = size + 1
    if at > size:
        raise file.damaged(f"it ends at byte {size}, inside point {bisect_right(starts, size)} of {count}")
    file.at = at
    file.end(count, "point")
    rows = np.asarray(starts)[:-1]
    points = _at_any_byte(data, POINT)[rows]
    lengths = points["track"].astype(np.int64)
    before = np.cumsum(lengths) - lengths
    elements = np.repeat(rows + POINT.itemsize - TRACK_ELEMENT * before, lengths)
    elements += TRACK_ELEMENT * np.arange(len(elements))
    images = _at_any_byte(data, np.dtype("<u4"))[elements]  # the number after it is that of a 2-D point
    return Points(points["id"], points["xyz"], points["color"], lengths, images)


def _at_any_byte(data: bytes, kind: np.dtype) -> np.ndarray:
    """Return a view whose item i is the one that begins at byte i."""
    return np.ndarray(max(0, len(data) - kind.itemsize + 1), kind, data, strides=(1,))
