"""Where the thermal image lies in the RGB image: one homography for all views of a pair of cameras.

It holds exactly at one distance: two lenses beside each other see near objects with parallax.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tdgbench.scenes import SceneError
from tdgbench.scenes.inputs import read_bytes
from tdgbench.scenes.radiometric import PhotoMapping

ASPECT_TOLERANCE = 0.01

Size = tuple[int, int]  # width, height in px


@dataclass(frozen=True)
class Mapping:
    """Homography (3, 3) from RGB to thermal pixels (pixel centres at integers + 1/2), and what it assumes, in words."""

    thermal_from_rgb: np.ndarray
    assumption: str

    def apply(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return thermal x and y of RGB positions of any shape, in px."""
        points = np.einsum("ij,j...->i...", self.thermal_from_rgb, np.stack([x, y, np.ones_like(x)]))
        with np.errstate(divide="ignore", invalid="ignore"):
            return points[0] / points[2], points[1] / points[2]


def same_view(rgb: Size, thermal: Size) -> Mapping:
    """Return the mapping of images that show the same field of view. Raises SceneError if their aspect ratios differ.

    >>> same_view((640, 480), (320, 240)).thermal_from_rgb.diagonal()
    array([0.5, 0.5, 1. ])
    """
    if abs(rgb[0] / rgb[1] * thermal[1] / thermal[0] - 1) > ASPECT_TOLERANCE:
        raise SceneError(
            f"RGB images are {rgb[0]}×{rgb[1]}, thermal images {thermal[0]}×{thermal[1]}: their fields of view differ. "
            "Say where the thermal image lies: --mapping RATIO X Y, or --homography FILE"
        )
    scale = np.diag([thermal[0] / rgb[0], thermal[1] / rgb[1], 1.0])
    if rgb == thermal:
        return Mapping(scale, "thermal and RGB images are aligned pixel by pixel")
    return Mapping(scale, "thermal and RGB images show the same field of view (no offset, no parallax)")


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
