"""Where thermal pixels lie in the RGB image, and the output's pixel grid, which both modalities are resampled to.

One homography per view maps RGB to thermal pixels. It holds exactly at one distance: two lenses beside each other see
near objects with parallax. Both images go through the same undistortion, that of the RGB camera; the output is cropped
to the thermal image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from scipy.ndimage import map_coordinates

from tdgbench.scenes import Camera, SceneError
from tdgbench.scenes.colmap import Undistortion
from tdgbench.scenes.formats import PhotoMapping
from tdgbench.scenes.images import nearest_valid, resize
from tdgbench.scenes.inputs import read_bytes
from tdgbench.scenes.view_images import ASPECT_TOLERANCE

Size = tuple[int, int]  # width, height in px
SMALLEST = 16  # px, of the output's sides


@dataclass(frozen=True)
class Mapping:
    """Homography (3, 3) from RGB to thermal pixels (pixel centres at integers + 1/2), and what it assumes, in words."""

    thermal_from_rgb: np.ndarray
    assumption: str
    stated: PhotoMapping | None = None  # the same as ratio and offset, unless it is more than these

    def indices(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns in the thermal image of those in the RGB image, of any shape (pixel indices)."""
        places = np.stack([columns + 0.5, rows + 0.5, np.ones_like(rows)])
        x, y, w = np.einsum("ij,j...->i...", self.thermal_from_rgb, places)
        with np.errstate(divide="ignore", invalid="ignore"):
            return y / w - 0.5, x / w - 0.5


def same_view(rgb: Size, thermal: Size) -> Mapping:
    """Return the mapping of images of one field of view. Raises SceneError if their aspect ratios differ.

    >>> same_view((640, 480), (320, 240)).thermal_from_rgb.diagonal()
    array([0.5, 0.5, 1. ])
    """
    if abs(rgb[0] / rgb[1] * thermal[1] / thermal[0] - 1) > ASPECT_TOLERANCE:
        raise SceneError(
            f"RGB images are {rgb[0]}×{rgb[1]}, thermal images {thermal[0]}×{thermal[1]}: their fields of view differ. "
            "Say where the thermal image lies: --mapping RATIO X Y, or --homography FILE"
        )
    scale = np.diag([thermal[0] / rgb[0], thermal[1] / rgb[1], 1.0])
    said = "are aligned pixel by pixel" if rgb == thermal else "show the same field of view (no offset, no parallax)"
    return Mapping(scale, f"thermal and RGB images {said}", PhotoMapping(1.0, 0.0, 0.0))


def inside_photo(stated: PhotoMapping, rgb: Size, thermal: Size, by: str) -> Mapping:
    """Return the mapping of a thermal image that covers 1 / ratio of the RGB image's width, with its centre off.

    by: who states it. Raises SceneError for numbers that put it outside of the RGB image.
    """
    if not (np.isfinite(stated.real_to_ir) and 0.05 < stated.real_to_ir < 20):
        raise SceneError(f"{by}: the ratio of fields of view is {stated.real_to_ir:g}; it must be 0.05 to 20")
    scale = stated.real_to_ir * thermal[0] / rgb[0]  # thermal px per RGB px
    if abs(stated.offset_x) > rgb[0] or abs(stated.offset_y) > rgb[1]:
        raise SceneError(f"{by}: the offset {stated.offset_x}, {stated.offset_y} px is larger than the RGB image")
    x = thermal[0] / 2 - scale * (rgb[0] / 2 + stated.offset_x)
    y = thermal[1] / 2 - scale * (rgb[1] / 2 + stated.offset_y)
    matrix = np.array([[scale, 0, x], [0, scale, y], [0, 0, 1.0]])
    return Mapping(
        matrix,
        f"the thermal image covers 1/{stated.real_to_ir:.4g} of the RGB image's width, its centre {stated.offset_x:g}, "
        f"{stated.offset_y:g} px off ({by}); one mapping for all distances, so near objects have parallax",
        stated,
    )


def from_file(path: Path) -> Mapping:
    """Read a homography from RGB to thermal pixels, a text file of 9 numbers as OpenCV's findHomography gives it.

    Pixel centres are at integers there. Raises SceneError.
    """
    try:
        matrix = np.array(read_bytes(path).decode().replace(",", " ").split(), np.float64).reshape(3, 3)
        if not (np.isfinite(matrix).all() and abs(np.linalg.det(matrix)) > 1e-12):
            raise ValueError("it has no inverse")
    except ValueError as error:
        what = "the 9 numbers of a homography from RGB to thermal pixels"
        raise SceneError(f"{path} must hold {what}: {error}") from error
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return Mapping(
        half @ matrix @ np.linalg.inv(half),
        f"the homography in {path.name}; one mapping for all distances, so near objects have parallax",
    )


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
        return self.rows.shape[1], self.rows.shape[0]

    def camera(self, world_to_camera: np.ndarray) -> Camera:
        """Return the camera of an output view with a pose (4, 4)."""
        return Camera(self.K, world_to_camera, *self.size)

    def rgb(self, image: np.ndarray) -> np.ndarray:
        """Return an RGB image (h, w, 3) on the grid: undistorted and cropped at its own resolution, then averaged.

        A box filter of whole pixels would move edges by up to half a pixel.
        """
        return resize(self.crop.apply(image).astype(np.float32), *self.size, Image.Resampling.HAMMING)

    def thermal(self, image: np.ndarray, mapping: Mapping) -> tuple[np.ndarray, np.ndarray]:
        """Return a thermal image (h, w) or (h, w, C) on the grid, bilinear, and which pixels (H, W) are measured.

        Others, beyond the thermal image or beside an invalid pixel, take the value of the nearest measured one.
        """
        planes = image[:, :, None] if image.ndim == 2 else image
        places = mapping.indices(self.rows, self.columns)
        sampled = np.stack([_bilinear(planes[..., c], *places) for c in range(planes.shape[2])], axis=2)
        valid = np.isfinite(sampled).all(axis=2)
        if not valid.all():
            sampled = nearest_valid(sampled, valid)
        return (sampled[..., 0] if image.ndim == 2 else sampled), valid


def make_grid(source: pycolmap.Camera, mapping: Mapping, thermal: Size) -> Grid:
    """Return the grid of the part of the undistorted RGB image that the thermal image covers.

    source: camera of the RGB images. thermal: size of the thermal images. One pixel of the output is one of the thermal
    image, but never finer than the RGB image. Raises SceneError if the thermal image lies outside of the RGB image.
    """
    whole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), source)
    rows, columns = mapping.indices(*Undistortion(source, whole, "the RGB camera").positions)
    inside = (rows > -0.5) & (rows < thermal[1] - 0.5) & (columns > -0.5) & (columns < thermal[0] - 0.5)
    top, bottom, left, right = _box(inside)
    if min(bottom - top, right - left) < SMALLEST:
        raise SceneError(f"the thermal image lies outside of the RGB image: {mapping.assumption}; correct the mapping")
    K = whole.calibration_matrix()
    crop = _pinhole((right - left, bottom - top), [K[0, 0], K[1, 1], K[0, 2] - left, K[1, 2] - top])
    density = _density(rows[top:bottom, left:right], columns[top:bottom, left:right])
    width = round(min(1.0, density) * crop.width)
    height = round(crop.height * width / crop.width)
    if min(width, height) < SMALLEST:
        raise SceneError(
            f"the output would be {width}×{height} px; both must be at least {SMALLEST}: use larger images"
        )
    scale = np.array([width / crop.width, height / crop.height] * 2)
    output = _pinhole((width, height), np.array(crop.params) * scale)
    fine = Undistortion(source, output, "the RGB camera")
    return Grid(Undistortion(source, crop, "the RGB camera"), *fine.positions, np.array(output.calibration_matrix()))


def no_distortion(rgb: Size) -> pycolmap.Camera:
    """Return a camera that leaves images as they are, for captures without a model."""
    return _pinhole(rgb, [rgb[0], rgb[0], rgb[0] / 2, rgb[1] / 2])


def _pinhole(size: Size, params: Sequence[float] | np.ndarray) -> pycolmap.Camera:
    return pycolmap.Camera(model="PINHOLE", width=size[0], height=size[1], params=params)


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


def _bilinear(plane: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return values at positions; NaN more than half a pixel outside, and where a neighbour is NaN."""
    height, width = plane.shape
    values = map_coordinates(plane.astype(np.float64), [rows, columns], order=1, mode="nearest")
    outside = (rows <= -0.5) | (rows >= height - 0.5) | (columns <= -0.5) | (columns >= width - 0.5)
    return np.where(outside | ~np.isfinite(rows + columns), np.nan, values)
