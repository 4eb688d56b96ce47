"""What the files of a COLMAP model hold, as read: cameras, images, points, rigs and frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap

from tdgbench.scenes.errors import SceneError

NO_POINT = 2**64 - 1  # point id of a 2-D point without a 3-D point
MOST_COMPARED = 500  # 2-D points of a view; for a median, more say nothing new
REMEDY = "copy or download the model again, or run COLMAP again"


class DamagedModelError(SceneError):
    """A file of a model is cut or changed."""

    def __init__(self, path: Path, what: str, remedy: str = REMEDY) -> None:
        super().__init__(f"{path} is damaged: {what}; {remedy}")


class PoseEntry(NamedTuple):
    """A rotation and a translation, from world or rig to camera or rig."""

    quaternion: tuple[float, ...]  # w, x, y, z
    translation: tuple[float, ...]

    @classmethod
    def of(cls, numbers) -> PoseEntry:
        """Return the pose of 7 numbers as COLMAP writes them: qw, qx, qy, qz, tx, ty, tz."""
        return cls(tuple(numbers[:4]), tuple(numbers[4:7]))


class Sensor(NamedTuple):
    """A camera or another sensor of a rig."""

    type: str  # a value of SENSORS
    id: int


SENSORS = {0: "CAMERA", 1: "IMU"}  # COLMAP's SensorType


class CameraEntry(NamedTuple):
    """A row of the cameras file."""

    id: int
    model: str  # COLMAP's name, as PINHOLE
    width: int  # px
    height: int  # px
    params: tuple[float, ...]


class ImageEntry(NamedTuple):
    """A row of the images file."""

    id: int
    pose: PoseEntry  # camera from world
    camera_id: int
    name: str
    point_ids: np.ndarray  # (N,) uint64, of the 3-D points of its 2-D points; NO_POINT without one
    compared: np.ndarray  # (C,) int64, which 2-D points are compared with projections
    pixels: np.ndarray  # (C, 2) float64, px, of the compared ones


class Points(NamedTuple):
    """The points file, in its order. The track elements of all points follow each other."""

    ids: np.ndarray  # (P,) uint64
    xyz: np.ndarray  # (P, 3) float64
    colors: np.ndarray  # (P, 3) uint8
    track_lengths: np.ndarray  # (P,) int64
    track_images: np.ndarray  # (T,) uint32, image ids
    track_points2D: np.ndarray  # (T,) uint32, indices into the image's 2-D points


class RigEntry(NamedTuple):
    """A row of the rigs file."""

    id: int
    sensors: dict[Sensor, PoseEntry | None]  # sensor from rig; of the first, the reference, it is the identity


class FrameEntry(NamedTuple):
    """A row of the frames file."""

    id: int
    rig_id: int
    pose: PoseEntry  # rig from world
    data: list[tuple[Sensor, int]]  # id of the sensor's data: of a camera, an image id


@dataclass(frozen=True)
class ModelTables:
    """A model as read, each row by its id. Models of COLMAP before 3.12 have no rigs and no frames."""

    folder: Path
    suffix: str  # of its files, .bin or .txt
    cameras: dict[int, CameraEntry]
    images: dict[int, ImageEntry]
    points: Points
    rigs: dict[int, RigEntry] = field(default_factory=dict)
    frames: dict[int, FrameEntry] = field(default_factory=dict)

    def file(self, name: str) -> Path:
        """Return the path of `cameras`, `images`, `points3D`, `rigs` or `frames`."""
        return self.folder / (name + self.suffix)


def to_compare(point_ids: np.ndarray) -> np.ndarray:
    """Return indices of at most MOST_COMPARED 2-D points with a 3-D point, evenly spaced.

    >>> to_compare(np.array([7, NO_POINT, 8], np.uint64))
    array([0, 2])
    """
    shown = np.flatnonzero(point_ids != NO_POINT)
    return shown[:: max(1, -(-len(shown) // MOST_COMPARED))]


@cache
def camera_models() -> dict[int, tuple[str, int]]:
    """Return the name and number of parameters of COLMAP's camera models, by model id.

    >>> camera_models()[1]
    ('PINHOLE', 4)
    """
    known = {int(model): name for name, model in pycolmap.CameraModelId.__members__.items() if int(model) >= 0}
    sizes = {
        number: len(pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId(number), 1.0, 8, 8).params)
        for number in known
    }
    return {number: (name, sizes[number]) for number, name in known.items()}


def by_id(path: Path, rows: list, what: str) -> dict:
    """Return the rows by id. Raises DamagedModelError if two have the same."""
    rows_by_id = {row.id: row for row in rows}
    if len(rows_by_id) < len(rows):
        seen: set[int] = set()
        twice = next(row.id for row in rows if row.id in seen or seen.add(row.id))  # type: ignore[func-returns-value]
        raise DamagedModelError(path, f"it holds {what} {twice} twice")
    return rows_by_id
