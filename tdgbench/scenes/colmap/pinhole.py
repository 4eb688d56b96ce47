"""Pinholes for COLMAP's cameras, and how to resample images to them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pycolmap
from scipy.ndimage import map_coordinates

from tdgbench.scenes.camera import Camera, check_intrinsics, check_size
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError

PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
MIN_SANE = 0.9  # share of a pinhole's pixels that must lie inside the distorted image, and in the same order
LARGEST_ID = 2**32 - 1  # of a camera, which COLMAP keeps for none
BLOCK = 1 << 20  # pixels that are mapped at a time


@dataclass(frozen=True)
class Undistortion:
    """How images of a distorted camera become those of a pinhole."""

    source: pycolmap.Camera
    pinhole: pycolmap.Camera
    where: str  # file and camera, for messages
    _known: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, compare=False)

    @property
    def source_size(self) -> tuple[int, int]:
        """Width and height of the distorted image, px."""
        return self.source.width, self.source.height

    @property
    def positions(self) -> tuple[np.ndarray, np.ndarray]:
        """`positions_at` the pinhole's own size."""
        return self.positions_at(self.pinhole.width, self.pinhole.height)

    def positions_at(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Return row and column (height, width) in the distorted image, float64 pixel indices, of a pinhole's pixels.

        The pinhole is resized to width × height px; the distorted image has the camera's size. Raises SceneError if the
        positions make no image: the distortion is damaged.
        """
        if (width, height) in self._known:
            return self._known[width, height]
        rows, columns = np.empty((height, width)), np.empty((height, width))
        across, down = self.pinhole.width / width, self.pinhole.height / height
        step = max(1, BLOCK // width)
        for first in range(0, height, step):
            block = slice(first, min(first + step, height))
            x, y = np.meshgrid((np.arange(width) + 0.5) * across, (np.arange(block.start, block.stop) + 0.5) * down)
            rays = self.pinhole.cam_from_img(np.stack([x.ravel(), y.ravel()], axis=-1))
            pixels = self.source.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
            columns[block], rows[block] = (pixels - 0.5).T.reshape(2, *x.shape)
        self._check(rows, columns)
        self._known[width, height] = rows, columns
        return rows, columns

    def size_for(self, width: int, height: int) -> tuple[int, int]:
        """Return width and height of the pinhole of images of width × height px, which may not be the camera's."""
        across, down = width / self.source.width, height / self.source.height
        return max(1, round(self.pinhole.width * across)), max(1, round(self.pinhole.height * down))

    def apply(self, image: np.ndarray) -> np.ndarray:
        """Resample an image (H, W, C) of any size bilinearly to `size_for` that size; the border is replicated."""
        height, width = image.shape[:2]
        positions = self.positions_at(*self.size_for(width, height))
        rows = (positions[0] + 0.5) * height / self.source_size[1] - 0.5
        columns = (positions[1] + 0.5) * width / self.source_size[0] - 0.5
        planes = [
            map_coordinates(image[..., c], [rows, columns], order=1, mode="nearest") for c in range(image.shape[2])
        ]
        return np.stack(planes, axis=-1)

    def _check(self, rows: np.ndarray, columns: np.ndarray) -> None:
        """Raise SceneError unless the positions are finite, mostly inside the image, and mostly in order."""
        if not (np.isfinite(rows).all() and np.isfinite(columns).all()):
            raise self._absurd("leads to positions that are not finite")
        width, height = self.source_size
        inside = (rows > -1.5) & (rows < height + 0.5) & (columns > -1.5) & (columns < width + 0.5)
        ordered = [np.mean(np.diff(v, axis=axis) > 0) for v, axis in ((rows, 0), (columns, 1)) if v.shape[axis] > 1]
        if inside.mean() < MIN_SANE or min(ordered, default=1.0) < MIN_SANE:
            raise self._absurd("folds the image or leaves it")

    def _absurd(self, what: str) -> SceneError:
        fixed = [*self.source.focal_length_idxs(), *self.source.principal_point_idxs()]
        distortion = [f"{value:g}" for value in np.delete(self.source.params, fixed)]
        return SceneError(f"{self.where}: the distortion {', '.join(distortion)} {what}. Correct the model")


def to_pinhole(entry: CameraEntry, where: str) -> tuple[Camera, Undistortion | None]:
    """Return a camera as a pinhole at the world's origin, and how to resample images.

    where: file and camera, for messages. A camera that is no pinhole becomes pycolmap's undistorted one. Raises
    SceneError for numbers that cannot be a camera's.
    """
    if not np.isfinite(entry.params).all():
        raise SceneError(f"{where} has parameters that are not finite. Correct the model")
    check_size(entry.width, entry.height, where)
    if not 0 <= entry.id < LARGEST_ID:
        raise SceneError(f"{where} has an id that is not from 0 to {LARGEST_ID - 1}. Correct the model")
    source = pycolmap.Camera(
        model=entry.model, width=entry.width, height=entry.height, params=list(entry.params), camera_id=entry.id
    )
    if not source.focal_length_idxs():  # pycolmap crashes where such a camera is asked for its focal length
        raise SceneError(f"{where} is {entry.model}, which no pinhole can show; render the scene with pinholes")
    as_it_is = _without_distortion(source, where)
    if entry.model in PINHOLES:
        return as_it_is, None
    try:
        pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), source)
    except Exception as error:
        raise SceneError(f"{where} cannot be undistorted: {error}. Correct the model") from error
    return _without_distortion(pinhole, f"{where}, undistorted,"), Undistortion(source, pinhole, where)


def _without_distortion(camera: pycolmap.Camera, where: str) -> Camera:
    focal = camera.focal_length_x, camera.focal_length_y
    principal = camera.principal_point_x, camera.principal_point_y
    check_intrinsics(camera.width, camera.height, focal, principal, where)
    return Camera(np.array(camera.calibration_matrix()), np.eye(4), camera.width, camera.height)
