"""The output's pixel grid, which both modalities are resampled to: undistorted, and cropped to the thermal image.

Both images go through the same undistortion, that of the RGB camera; the thermal image is found through the mapping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from PIL import Image
from scipy.ndimage import map_coordinates

from tdgbench.data.prepare.mapping import Mapping, Size
from tdgbench.scenes import Camera, SceneError
from tdgbench.scenes.colmap import Undistortion
from tdgbench.scenes.images import nearest_valid

SMALLEST = 16  # px, of the output's sides


@dataclass(frozen=True)
class Grid:
    """Pixels of the output.

    crop: the output's field of view at the RGB image's resolution, as a resampling. rows, columns: (H, W) positions of
    the output's pixels in the RGB image, in pixel indices. K: (3, 3) of the output's pinhole.
    """

    crop: Undistortion
    rows: np.ndarray
    columns: np.ndarray
    K: np.ndarray

    @property
    def size(self) -> Size:
        """Width and height of the output."""
        return self.rows.shape[1], self.rows.shape[0]

    def camera(self, world_to_camera: np.ndarray) -> Camera:
        """Return camera of an output view with a pose (4, 4)."""
        return Camera(self.K, world_to_camera, *self.size)

    def rgb(self, image: np.ndarray) -> np.ndarray:
        """Return RGB image (h, w, 3) on the grid: undistorted and cropped at its own resolution, then averaged."""
        return _averaged(self.crop.apply(image).astype(np.float32), self.size)

    def thermal(self, image: np.ndarray, mapping: Mapping) -> tuple[np.ndarray, np.ndarray]:
        """Return thermal image (h, w) or (h, w, C) on the grid, bilinear, and which pixels (H, W) are measured.

        Others, beyond the thermal image or beside an invalid pixel, take the value of the nearest measured one.
        """
        planes = image[:, :, None] if image.ndim == 2 else image
        places = _thermal_positions((self.rows, self.columns), mapping)
        sampled = np.stack([_bilinear(planes[..., c], *places) for c in range(planes.shape[2])], axis=2)
        valid = np.isfinite(sampled).all(axis=2)
        if not valid.all():
            sampled = nearest_valid(sampled, valid)
        return (sampled[..., 0] if image.ndim == 2 else sampled), valid


def make_grid(source: pycolmap.Camera, mapping: Mapping, thermal: Size, width: int | None = None) -> Grid:
    """Return grid of the part of the undistorted RGB image that the thermal image covers.

    source: camera of the RGB images; where no model is known, `no_distortion`. thermal: size of the thermal images.
    width: of the output in px; by default one pixel of the output is one of the thermal image, but never finer than
    the RGB image. Raises SceneError if the thermal image lies outside of the RGB image.
    """
    whole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), source)
    positions = Undistortion(source, whole, "the RGB camera").positions
    rows, columns = _thermal_positions(positions, mapping)
    inside = (rows > -0.5) & (rows < thermal[1] - 0.5) & (columns > -0.5) & (columns < thermal[0] - 0.5)
    top, bottom, left, right = _box(inside)
    if min(bottom - top, right - left) < SMALLEST:
        raise SceneError(f"the thermal image lies outside of the RGB image: {mapping.assumption}; correct the mapping")
    crop = _cropped(whole, left, top, right - left, bottom - top)
    if width is None:
        density = _density(rows[top:bottom, left:right], columns[top:bottom, left:right])
        width = round(min(1.0, density) * crop.width)
    height = round(crop.height * width / crop.width)
    if min(width, height) < SMALLEST:
        raise SceneError(f"the output would be {width}×{height} px; both must be at least {SMALLEST}: set --width")
    output = pycolmap.Camera(
        model="PINHOLE", width=width, height=height,
        params=np.array(crop.params) * np.array([width / crop.width, height / crop.height] * 2),
    )  # fmt: skip
    fine = Undistortion(source, output, "the RGB camera")
    return Grid(
        Undistortion(source, crop, "the RGB camera"),
        *fine.positions,
        np.array(output.calibration_matrix()),
    )


def no_distortion(rgb: Size) -> pycolmap.Camera:
    """Return A camera that leaves images as they are, where no model is known."""
    width, height = rgb
    return pycolmap.Camera(model="PINHOLE", width=width, height=height, params=[width, width, width / 2, height / 2])


def _averaged(image: np.ndarray, size: Size) -> np.ndarray:
    """Return image (h, w, C) at a smaller size. A box filter of whole pixels would move edges by up to half a pixel."""
    if size == image.shape[1::-1]:
        return image
    planes = [Image.fromarray(np.ascontiguousarray(image[..., c])) for c in range(image.shape[2])]
    return np.stack([np.asarray(plane.resize(size, Image.Resampling.HAMMING)) for plane in planes], axis=-1)


def _thermal_positions(rgb_positions: tuple[np.ndarray, np.ndarray], mapping: Mapping) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns in the thermal image of rows and columns in the RGB image (pixel indices)."""
    rows, columns = rgb_positions
    x, y = mapping.apply(columns + 0.5, rows + 0.5)
    return y - 0.5, x - 0.5


def _box(inside: np.ndarray) -> tuple[int, int, int, int]:
    """Return top, bottom, left and right of the box around the true pixels, without lines that are mostly false."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return 0, 0, 0, 0
    top, bottom, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    while bottom - top > SMALLEST and right - left > SMALLEST:
        box = inside[top:bottom, left:right]
        shares = [box[0].mean(), box[-1].mean(), box[:, 0].mean(), box[:, -1].mean()]
        side = int(np.argmin(shares))
        if shares[side] >= 0.5:
            break
        top, bottom, left, right = top + (side == 0), bottom - (side == 1), left + (side == 2), right - (side == 3)
    return top, bottom, left, right


def _density(rows: np.ndarray, columns: np.ndarray) -> float:
    """Return thermal pixels per RGB pixel along a side, from their positions in the thermal image."""
    (down_rows, right_rows), (down_columns, right_columns) = np.gradient(rows), np.gradient(columns)
    return float(np.sqrt(np.median(np.abs(right_columns * down_rows - right_rows * down_columns))))


def _cropped(camera: pycolmap.Camera, left: int, top: int, width: int, height: int) -> pycolmap.Camera:
    K = camera.calibration_matrix()
    return pycolmap.Camera(
        model="PINHOLE", width=width, height=height, params=[K[0, 0], K[1, 1], K[0, 2] - left, K[1, 2] - top]
    )  # fmt: skip


def _bilinear(plane: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return values at positions; NaN more than half a pixel outside, and where a neighbour is NaN."""
    height, width = plane.shape
    values = map_coordinates(plane.astype(np.float64), [rows, columns], order=1, mode="nearest")
    outside = (rows <= -0.5) | (rows >= height - 0.5) | (columns <= -0.5) | (columns >= width - 0.5)
    return np.where(outside | ~np.isfinite(rows + columns), np.nan, values)
