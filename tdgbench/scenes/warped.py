"""Gray images of temperatures that were warped into another camera, as ThermalMix ships them.

Facts: mert-o/ThermalNeRFs e1d4e26, img_temp_mapper.py. Black and white are the lowest and the highest temperature of
the scene. Pixels of `warped_thermal/<view>.jpg` that are darker than every pixel of the image before the warp,
`thermal/<view>.jpg`, are the warp's filler. The authors raise them to that minimum and save the array; here they are
masked.

Both images are JPEGs. A measured pixel may be a few levels below the minimum by their noise, and a filler spoils the
blocks that it lies in. So a region below the minimum is filler if as many of its pixels as a block has are nearer to
black than to the minimum; it grows to whole blocks. Noise is raised to the minimum, as the authors do. A minimum that
is itself nearly black tells nothing: then, and without an image before the warp, fillers are found as in arrays
(`fillers.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.fillers import grown
from tdgbench.scenes.formats import decode
from tdgbench.scenes.images import unit_image
from tdgbench.scenes.measured import Temperatures, read_temperatures
from tdgbench.scenes.temperature import Radiometry

PICTURES = (".jpg", ".jpeg", ".png")
JPEG = (".jpg", ".jpeg")
BLOCK = 8  # px, side of a JPEG's blocks
NOISE = 4 / 255  # image value; minima below it cannot be told from black
MOST_COLOR = 8 / 255  # image value; by which channels of a gray image may differ
LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R 601, as OpenCV reads colour images as gray


@dataclass(frozen=True)
class WarpedPictures:
    """Warped gray images and what their values mean. Called with a path, it reads the temperatures.

    unwarped: images before the warp, by view name. mask: whether fillers are masked; else all are raised. Views may
    have .npy files instead.
    """

    radiometry: Radiometry
    unwarped: Mapping[str, Path]
    mask: bool

    def __call__(self, path: Path) -> Temperatures:
        if not is_picture(path):
            return read_temperatures(path, self.radiometry.scale)
        image, before = self._gray(path), self.unwarped.get(path.stem)
        block = BLOCK if path.suffix.lower() in JPEG else 1
        filler = None
        if before is not None:
            lowest = float(self._gray(before).min())
            if self.mask and lowest >= NOISE:
                filler = filler_below(image, lowest, block)
            image = np.maximum(image, np.float32(lowest))
        span = self.radiometry.range
        degC = (span.min * (1 - image.astype(np.float64)) + span.max * image).astype(np.float32)
        if filler is not None:
            degC[filler] = np.nan
        return Temperatures(degC, filler is not None, block, ends=True)

    def _gray(self, path: Path) -> np.ndarray:
        """Return the image (H, W) float32 in [0, 1]. Raises SceneError for one in colours."""
        image = unit_image(decode(path, as_picture=True), path, self.radiometry)
        if np.ptp(image, axis=2).max() > MOST_COLOR:
            raise SceneError(
                f"{path} is in colours, but temperatures are read from gray images; replace it by the gray image, or "
                f"put {path.stem}.npy in °C beside it"
            )
        return image[..., 0] if image.shape[2] == 1 else image @ LUMA


def is_picture(path: Path) -> bool:
    """Return whether a file is an image of temperatures, not an array.

    >>> is_picture(Path("1.JPG")), is_picture(Path("1.npy"))
    (True, False)
    """
    return path.suffix.lower() in PICTURES


def filler_below(image: np.ndarray, lowest: float, block: int) -> np.ndarray:
    """Return pixels (H, W) bool of an image (H, W) that are a warp's filler, or spoiled by it.

    lowest: of the image before the warp. block: side of the blocks in which a filler spoils its neighbours, px.
    """
    labels, count = ndimage.label(image < lowest)
    dark = np.bincount(labels[image <= lowest / 2], minlength=count + 1)
    is_filler = dark >= BLOCK**2
    is_filler[0] = False  # pixels that are not below the minimum
    return grown(is_filler[labels], block)
