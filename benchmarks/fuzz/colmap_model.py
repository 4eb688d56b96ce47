"""A COLMAP model as plain numbers, and what makes it unusable."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

PARAMETERS = {0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4, 9: 5, 10: 12}  # numbers per camera model
NAMES = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
         "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE")  # fmt: skip
NO_POINT = 2**64 - 1
MIN_OBSERVATIONS = 8
MAX_ERROR = 0.1  # median reprojection error of a usable camera, as a share of the image's diagonal


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
    """A registered image. pose: qw, qx, qy, qz, tx, ty, tz of camera from world. points: x, y (px), id of its point."""

    id: int
    pose: list[float]
    camera: int
    name: str
    points: list[tuple[float, float, int]]

    @property
    def view(self) -> str:
        """Name of the view: the file name without folder and extension."""
        return PurePosixPath(self.name.replace("\\", "/")).stem


@dataclass
class Point:
    """A sparse point. color: 0 to 255. track: id of an image, index into its points."""

    id: int
    xyz: list[float]
    color: list[int]
    error: float
    track: list[tuple[int, int]]


@dataclass
class Rig:
    """A rig; the first sensor (type, id) is its reference. The suite's rigs have one sensor."""

    id: int
    sensors: list[tuple[int, int]]


@dataclass
class Frame:
    """One moment of a rig. pose: as of an image, of the rig from the world. data: type, sensor id, image id."""

    id: int
    rig: int
    pose: list[float]
    data: list[tuple[int, int, int]]


@dataclass
class Model:
    """Content of a model's files; rigs and frames are None where they have no files."""

    cameras: list[Camera]
    images: list[Image]
    points: list[Point]
    rigs: list[Rig] | None = None
    frames: list[Frame] | None = None

    def pose(self, image: Image) -> np.ndarray:
        """World to camera (4, 4) of an image: that of its frame, where there are frames."""
        q, t = np.split(np.array(self._pose_of(image), np.float64), [4])
        w, x, y, z = q / np.linalg.norm(q)
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, 3] = t
        return matrix

    def _pose_of(self, image: Image) -> list[float]:
        if self.frames is None:
            return image.pose
        return next(frame.pose for frame in self.frames if (0, image.camera, image.id) in frame.data)

    def problems(self) -> list[str]:
        """Reasons why no program should use the model; none if it is sound."""
        return [*self._references()] or [*self._numbers()]

    def doubts(self) -> list[str]:
        """Images, of a model without problems, whose observations say that a camera is wrong or that points are gone.

        A program may use it, since models may be edited on purpose, but has to say so.
        """
        return [*self._missing_points(), *self._observations()]

    def _missing_points(self):
        """Images that show points which are not there: removed on purpose, or lost."""
        known = {point.id for point in self.points} | {NO_POINT}
        yield from (
            f"image {i.id} shows points that are not there" for i in self.images if {p for *_, p in i.points} - known
        )

    def _references(self):
        """Ids that occur twice or name nothing."""
        lists = {"camera": self.cameras, "image": self.images, "point": self.points, "rig": self.rigs or [],
                 "frame": self.frames or []}  # fmt: skip
        ids = {what: [one.id for one in some] for what, some in lists.items()}
        known = {what: set(some) for what, some in ids.items()}
        yield from (f"two {what}s have one id" for what, some in ids.items() if len(some) != len(known[what]))
        if not self.images:
            yield "no image"
        if len({image.view for image in self.images}) != len(self.images):
            yield "two images have one name"
        yield from (f"image {i.id}: no camera {i.camera}" for i in self.images if i.camera not in known["camera"])
        sizes = {image.id: len(image.points) for image in self.images}
        for point in self.points:
            if any(index >= sizes.get(image, 0) for image, index in point.track):
                yield f"point {point.id} is observed by nothing"
        if self.frames is not None:
            placed = [datum for frame in self.frames for datum in frame.data]
            if sorted(placed) != sorted((0, image.camera, image.id) for image in self.images):
                yield "frames and images do not match"
            rigs = {rig.id: rig.sensors for rig in self.rigs or []}
            if any(datum[:2] not in rigs.get(f.rig, []) for f in self.frames for datum in f.data):
                yield "frames and rigs do not match"

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
            pose = np.array(self._pose_of(image))
            if not np.isfinite(pose).all() or np.abs(pose).max() > 1e12 or np.linalg.norm(pose[:4]) < 1e-9:
                yield f"image {image.id} has pose {pose}"
        for point in self.points:
            if not np.isfinite(np.array(point.xyz, np.float64)).all() or np.abs(point.xyz).max() > 1e30:
                yield f"point {point.id} is at {point.xyz}"

    def _observations(self):
        """Images whose camera does not see its points where the image shows them."""
        places = {point.id: point.xyz for point in self.points}
        cameras = {camera.id: camera for camera in self.cameras}
        for image in self.images:
            camera, seen = cameras[image.camera], [p for p in image.points if p[2] != NO_POINT]
            K = camera.matrix
            if K is None or len(seen) < MIN_OBSERVATIONS:
                continue
            world = self.pose(image)
            local = np.array([places[point] for *_, point in seen]) @ world[:3, :3].T + world[:3, 3]
            with np.errstate(all="ignore"):
                pixels = local @ K.T
                pixels = pixels[:, :2] / np.where(pixels[:, 2:] > 0, pixels[:, 2:], np.nan)
                errors = np.linalg.norm(pixels - np.array([p[:2] for p in seen]), axis=1)
            error = np.median(np.where(np.isfinite(errors), errors, np.inf))
            if error > MAX_ERROR * math.hypot(camera.width, camera.height):
                yield f"image {image.id}: its points are {error:.3g} px from where it shows them"
