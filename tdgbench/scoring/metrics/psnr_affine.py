"""PSNR after the best gain and offset of each view, which removes the effect of a drifting camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.scoring.metric import ImageMetric
from tdgbench.scoring.metrics.psnr import IN_DB, psnr


class GainAndOffset(NamedTuple):
    """A view's two parameters: value = gain · rendered value + offset, the same for all channels."""

    gain: float
    offset: float

    def of(self, image: np.ndarray) -> np.ndarray:
        """Return the image with this gain and offset, clipped to [0, 1]."""
        return np.clip(self.gain * image.astype(np.float64) + self.offset, 0, 1)


def best_gain_and_offset(image: np.ndarray, target: np.ndarray) -> GainAndOffset:
    """Return the gain ≥ 0 and offset that bring an image nearest to its target, by least squares over all values.

    A gain below 0 would turn hot into cold. An image of one value gets an offset only.

    >>> image = np.array([0.2, 0.4, 0.6])
    >>> response = best_gain_and_offset(image, 0.5 * image + 0.1)
    >>> round(response.gain, 6), round(response.offset, 6)
    (0.5, 0.1)
    """
    x, y = image.astype(np.float64), target.astype(np.float64)
    spread = float(np.mean((x - x.mean()) ** 2))
    gain = max(float(np.mean((x - x.mean()) * (y - y.mean()))) / spread, 0.0) if spread > 0 else 1.0
    return GainAndOffset(gain, float(y.mean() - gain * x.mean()))


def psnr_affine(image: np.ndarray, target: np.ndarray) -> float:
    """Return the PSNR (dB) of images (…, C) in [0, 1] after the render's best gain and offset.

    nerfbaselines and gsplat call PSNR after a fitted affine map of colours colour-corrected; theirs has a 3×3 matrix,
    which has no meaning for temperatures.
    """
    return psnr(best_gain_and_offset(image, target).of(image), target)


METRIC = ImageMetric(
    name="psnr_affine",
    label="PSNR after gain and offset",
    meaning="PSNR after the gain and offset of each test view that fit it best",
    order=42,
    **IN_DB,
    fits_to_test_view="gain and offset",
    of_images=lambda pair: psnr_affine(*pair.pixels),
)
