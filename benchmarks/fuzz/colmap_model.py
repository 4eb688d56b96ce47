"""A COLMAP model as plain numbers, and what makes it unusable."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

PARAMETERS = {0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4, 9: 5, 10: 12}  # numbers per camera model
NAMES = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
         "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE")  # fmt: skip
NO_POINT = 2**64 - 1


class MalformedError(Exception):
    """A file does not follow COLMAP's format."""


@dataclass
class Camera:
    """Intrinsics. kind: index into NAMES. params: px, in COLMAP's order."""

    id: int
    kind: int
    width: int
    height: int
    params: list[float]

    @property
    def matrix(self) -> np.ndarray | None:
        """K (3, 3) in px; None for a camera with distortion."""
        if self.kind not in (0, 1):
            return None
        fx, fy = (self.params[0],) * 2 if self.kind == 0 else self.params[:2]
        return np.array([[fx, 0, self.params[-2]], [0, fy, self.params[-1]], [0, 0, 1.0]])


@dataclass
class Image:
    """A registered image. pose: qw, qx, qy, qz, tx, ty, tz of camera from world. points: x, y (px), id of its point;
    words where they were read from text, since no reader of tdgbench needs them.
    """

    id: int
    pose: list[float]
    camera: int
    name: str
    points: list[tuple[Any, Any, Any]]

    @property
    def view(self) -> str:
        """Name of the view: the file name without folder and extension."""
        return PurePosixPath(self.name.replace("\\", "/")).stem


@dataclass
class Point:
    """A sparse point. color: 0 to 255. track: id of an image, index into its points, or
    words.
    """

    id: int
    xyz: list[float]
    color: list[int]
    error: float
    track: list[tuple[Any, Any]]


@dataclass
class Model:
    """Content of a model's files."""

    cameras: list[Camera]
    images: list[Image]
    points: list[Point]

    def pose(self, image: Image) -> np.ndarray:
        """World to camera (4, 4) of an image."""
        q, t = np.split(np.array(image.pose, np.float64), [4])
        w, x, y, z = q / np.linalg.norm(q)
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, 3] = t
        return matrix

    def problems(self) -> list[str]:
        """Reasons why no program should use the model; none if it is sound."""
        return [*self._references()] or [*self._numbers()]

    def _references(self):
        """Ids that occur twice or name nothing."""
        lists = {"camera": self.cameras, "point": self.points}
        ids = {what: [one.id for one in some] for what, some in lists.items()}
        known = {what: set(some) for what, some in ids.items()}
        yield from (f"two {what}s have one id" for what, some in ids.items() if len(some) != len(known[what]))
        if not self.images:
            yield "no image"
        if len({image.view for image in self.images}) != len(self.images):
            yield "two images have one name"
        yield from (f"image {i.id}: no camera {i.camera}" for i in self.images if i.camera not in known["camera"])

    def _numbers(self):
        """Numbers that are not finite, or absurd."""
        for camera in self.cameras:
            size = max(camera.width, camera.height)
            focal = camera.params[: 2 if camera.kind in (1, 4, 5, 6, 10) else 1]
            if not 0 < min(camera.width, camera.height) <= size <= 100_000:
                yield f"camera {camera.id} is {camera.width}×{camera.height}"
            elif not all(map(math.isfinite, camera.params)):
                yield f"camera {camera.id} is not finite"
            elif not all(1e-3 * size < f < 1e4 * size for f in focal):
                yield f"camera {camera.id} has focal length {focal}"
            elif max(map(abs, camera.params)) > 1e4 * size:
                yield f"camera {camera.id} has parameters {camera.params}"
        for image in self.images:
            pose = np.array(image.pose)
            if not np.isfinite(pose).all() or np.abs(pose).max() > 1e12 or np.linalg.norm(pose[:4]) < 1e-9:
                yield f"image {image.id} has pose {pose}"
        for point in self.points:
            if not np.isfinite(np.array(point.xyz, np.float64)).all() or np.abs(point.xyz).max() > 1e30:
                yield f"point {point.id} is at {point.xyz}"
