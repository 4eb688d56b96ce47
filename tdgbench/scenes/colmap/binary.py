"""COLMAP's binary files, read so that every count and length is proved against the file's size first.

Layout: COLMAP's src/colmap/scene/reconstruction_io_binary.cc; all numbers are little-endian. pycolmap's own reader
believes the counts: a file one byte short makes it allocate without end.
"""

from __future__ import annotations

from pathlib import Path
from struct import Struct
from struct import error as StructError

import numpy as np

from tdgbench.scenes.colmap.tables import CameraEntry, DamagedModelError, ImageEntry, Points, camera_models
from tdgbench.scenes.inputs import read_bytes

COUNT = Struct("<Q")
CAMERA = Struct("<IiQQ")
IMAGE = Struct("<I7dI")
POINT2D = 24  # bytes
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


def read_images(path: Path) -> list[ImageEntry]:
    """Read the rows of images.bin. Raises SceneError."""
    file, images = _Cursor(path), []
    for _ in file.rows("image", IMAGE.size + 1 + COUNT.size):
        image_id, *pose, camera_id = file.take(IMAGE)
        name = file.name()
        points = file.count("2-D points", POINT2D)
        file.at += POINT2D * points
        images.append(ImageEntry(image_id, pose[:4], pose[4:], camera_id, name))
    return images


def read_points(path: Path) -> Points:
    """Read the rows of points3D.bin. Raises SceneError."""
    file = _Cursor(path)
    count = file.count("points", POINT.itemsize)
    data, size, at, rows, tracks = file.data, len(file.data), file.at, [], []
    to_length, length_at = POINT.fields["track"][1], COUNT.unpack_from  # type: ignore[index]
    try:
        for _ in range(count):  # without _Cursor's checks, since models have millions of points
            (length,) = length_at(data, at + to_length)
            rows.append(data[at : at + POINT.itemsize])
            tracks.append(data[at + POINT.itemsize : (at := at + POINT.itemsize + TRACK_ELEMENT * length)])
    except (StructError, OverflowError):
        at = size + 1
    if at > size:
        raise file.damaged(f"it ends at byte {size}, inside point {len(rows)} of {count}")
    file.at = at
    file.end(count, "point")
    points = np.frombuffer(b"".join(rows), POINT)
    images = np.frombuffer(b"".join(tracks), "<u4")[::2]  # the other numbers are those of 2-D points
    return Points(points["id"], points["xyz"], points["color"], points["track"].astype(np.int64), images)
