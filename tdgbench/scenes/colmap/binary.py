"""COLMAP's binary files, read so that every count and length is proved against the file's size first.

Layout: COLMAP's src/colmap/scene/reconstruction_io_binary.cc; all numbers are little-endian. pycolmap's own reader
believes the counts: a file one byte short makes it allocate without end.
"""

from __future__ import annotations

from pathlib import Path
from struct import Struct
from struct import error as StructError

import numpy as np

from tdgbench.scenes.colmap.tables import (
    SENSORS,
    CameraEntry,
    DamagedModelError,
    FrameEntry,
    ImageEntry,
    Points,
    PoseEntry,
    RigEntry,
    Sensor,
    camera_models,
    to_compare,
)
from tdgbench.scenes.inputs import read_bytes

COUNT = Struct("<Q")
UINT = Struct("<I")
FLAG = Struct("<B")
SENSOR = Struct("<iI")
POSE = Struct("<7d")
CAMERA = Struct("<IiQQ")
IMAGE = Struct("<I7dI")
FRAME = Struct("<II7d")
DATA = Struct("<iIQ")
POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("color", "u1", 3), ("error", "<f8"), ("track", "<u8")])
TRACK = np.dtype([("image", "<u4"), ("point2D", "<u4")])
LONGEST_NAME = 4096  # bytes; Linux's PATH_MAX


class _Cursor:
    """A place in a file. `row` says what is being read, for messages."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at, self.row = path, read_bytes(path), 0, "the file"

    def damaged(self, what: str) -> DamagedModelError:
        return DamagedModelError(self.path, what)

    def need(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise self.damaged(f"{self.row} needs {self.at + size} bytes, but the file has {len(self.data)}")

    def take(self, form: Struct) -> tuple:
        self.need(form.size)
        values = form.unpack_from(self.data, self.at)
        self.at += form.size
        return values

    def count(self, form: Struct, what: str, smallest: int) -> int:
        """Read a number of items of at least `smallest` bytes each, which the rest of the file has room for."""
        (count,) = self.take(form)
        if count * smallest > len(self.data) - self.at:
            raise self.damaged(
                f"{self.row} counts {count} {what}, which need {count * smallest} bytes or more, but "
                f"{len(self.data) - self.at} of {len(self.data)} are left"
            )
        return count

    def rows(self, what: str, smallest: int):
        """Number each row of the file; afterwards, check that nothing is left over."""
        count = self.count(COUNT, f"{what}s", smallest)
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

    def sensor(self) -> Sensor:
        number, sensor_id = self.take(SENSOR)
        if number not in SENSORS:
            raise self.damaged(f"{self.row} has a sensor of unknown type {number}")
        return Sensor(SENSORS[number], sensor_id)


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
        count = file.count(COUNT, "2-D points", POINT2D.itemsize)
        points = np.frombuffer(file.data, POINT2D, count, file.at)
        file.at += points.nbytes
        point_ids = points["point"].copy()
        compared = to_compare(point_ids)
        images.append(
            ImageEntry(image_id, PoseEntry.of(pose), camera_id, name, point_ids, compared, points["xy"][compared])
        )
    return images


def read_points(path: Path) -> Points:
    """Read the rows of points3D.bin. Raises SceneError."""
    file = _Cursor(path)
    count = file.count(COUNT, "points", POINT.itemsize)
    starts = _starts_of_points(file, count)
    file.end(count, "point")
    data = np.frombuffer(file.data, np.uint8)[COUNT.size :]
    edges = np.zeros(len(data) + 1, np.int8)  # +1 where the fixed part of a point begins, -1 where its track begins
    edges[starts - COUNT.size] += 1
    edges[starts - COUNT.size + POINT.itemsize] -= 1
    is_fixed = np.cumsum(edges[:-1], dtype=np.int8).view(bool)
    rows, tracks = data[is_fixed].view(POINT), data[~is_fixed].view(TRACK)
    return Points(
        rows["id"], rows["xyz"], rows["color"], rows["track"].astype(np.int64), tracks["image"], tracks["point2D"]
    )


def _starts_of_points(file: _Cursor, count: int) -> np.ndarray:
    """Return first byte (P,) of each point; the cursor ends behind the last."""
    data, size, to_length = file.data, len(file.data), POINT.fields["track"][1]  # type: ignore[index]
    starts, at, track_size = [], file.at, TRACK.itemsize
    length_at = COUNT.unpack_from
    try:
        for _ in range(count):
            (length,) = length_at(data, at + to_length)
            starts.append(at)
            at += POINT.itemsize + track_size * length
    except (StructError, OverflowError):
        at = size + 1
    if at > size:
        last = len(starts)
        raise file.damaged(f"it ends at byte {size}, inside point {last} of {count} (byte {starts[-1] if last else 8})")
    file.at = at
    return np.array(starts, np.int64)


def read_rigs(path: Path) -> list[RigEntry]:
    """Read the rows of rigs.bin. Raises SceneError."""
    file, rigs = _Cursor(path), []
    for _ in file.rows("rig", 2 * UINT.size):
        (rig_id,) = file.take(UINT)
        sensors: dict[Sensor, PoseEntry | None] = {}
        for index in range(file.count(UINT, "sensors", SENSOR.size)):
            sensor = file.sensor()
            if sensor in sensors:
                raise file.damaged(f"{file.row} has {sensor.type} {sensor.id} twice")
            has_pose = file.take(FLAG)[0] if index > 0 else 0
            if has_pose not in (0, 1):
                raise file.damaged(f"{file.row} has {has_pose} where 0 or 1 says whether a sensor has a pose")
            sensors[sensor] = PoseEntry.of(file.take(POSE)) if has_pose else None
        rigs.append(RigEntry(rig_id, sensors))
    return rigs


def read_frames(path: Path) -> list[FrameEntry]:
    """Read the rows of frames.bin. Raises SceneError."""
    file, frames = _Cursor(path), []
    for _ in file.rows("frame", FRAME.size + UINT.size):
        frame_id, rig_id, *pose = file.take(FRAME)
        data = []
        for _ in range(file.count(UINT, "data ids", DATA.size)):
            sensor = file.sensor()
            data.append((sensor, file.take(COUNT)[0]))
        frames.append(FrameEntry(frame_id, rig_id, PoseEntry.of(pose), data))
    return frames
