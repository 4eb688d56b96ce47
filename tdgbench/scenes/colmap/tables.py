"""What is read of the files of a COLMAP model: cameras, images, points.

Rigs and frames are not read, since the images file has all poses; 2-D points only where they are asked for.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap

from tdgbench.scenes.errors import SceneError

OBSERVED = np.dtype([("xy", "<f8", 2), ("point", "<u8")])  # 2-D points as images.bin has them; point: its id, if known
ROUNDING = 1e-12  # of a quaternion's norm
REMEDY = "copy or download the model again, or run COLMAP again"


class DamagedModelError(SceneError):
    """A file of a model is cut or changed. another: what else may help, after the remedy."""

    def __init__(self, path: Path, what: str, another: str = "") -> None:
        super().__init__(f"{path} is damaged: {what}; {REMEDY}{another}")


class CameraEntry(NamedTuple):
    """A row of the cameras file."""

    id: int
    model: str  # COLMAP's name, as PINHOLE
    width: int  # px
    height: int  # px
    params: tuple[float, ...]


class ImageEntry(NamedTuple):
    """A row of the images file. Its pose leads from the world to the camera."""

    id: int
    quaternion: list[float]  # w, x, y, z
    translation: list[float]
    camera_id: int
    name: str
    points: np.ndarray = np.empty(0, OBSERVED)  # (N,) OBSERVED; empty unless asked for

    @property
    def pose(self) -> np.ndarray:
        """World to camera (3, 4), of the quaternion at length 1: pycolmap takes another length as it is."""
        w, x, y, z = self.quaternion
        quaternion, norm = np.array([x, y, z, w]), math.hypot(w, x, y, z)
        if abs(norm - 1) > ROUNDING:
            quaternion /= norm
        matrix: np.ndarray = pycolmap.Rigid3d(pycolmap.Rotation3d(quaternion), np.array(self.translation)).matrix()
        return matrix


class Points(NamedTuple):
    """The points file, in its order."""

    ids: np.ndarray  # (P,) uint64
    xyz: np.ndarray  # (P, 3) float64
    colors: np.ndarray  # (P, 3) uint8
    lengths: np.ndarray  # (P,) int64, of the tracks
    images: np.ndarray  # (sum of lengths,) uint32, ids of the images in the tracks, one after another


@cache
def camera_models() -> dict[int, tuple[str, int]]:
    """Return the name and number of parameters of COLMAP's camera models, by model id.

    >>> camera_models()[1]
    ('PINHOLE', 4)
    """
    models = [model for model in pycolmap.CameraModelId.__members__.values() if int(model) >= 0]
    cameras = [pycolmap.Camera.create_from_model_id(1, model, 1.0, 8, 8) for model in models]
    return {int(model): (model.name, len(camera.params)) for model, camera in zip(models, cameras, strict=True)}
