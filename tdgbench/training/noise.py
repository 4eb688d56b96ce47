"""Noise of images, estimated from the images alone."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import convolve

QUANTISATION = 1 / 255 / 12**0.5  # standard deviation of rounding to 8 bits
MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]]) / 6.0  # unit noise has a response of unit variance
MAD_TO_SIGMA = 1.4826  # of a normal distribution


def noise_of(image: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Standard deviation of white noise in an image (H, W, C), in units of its values; at least that of 8 bits.

    The mask of Immerkær (1996, Fast Noise Variance Estimation) does not see planes and straight steps; the median of
    its absolute response does not see the rest of the edges. valid: bool (H, W); windows with a masked pixel do not
    count.

    >>> noise = np.random.default_rng(0).normal(0.5, 0.02, (64, 64, 1))
    >>> round(noise_of(noise), 3)
    0.02
    """
    if min(image.shape[:2]) < 3:
        return QUANTISATION
    response = np.abs(convolve(image.astype(np.float64), MASK[..., None])[1:-1, 1:-1])
    if valid is not None:
        response = response[convolve(valid.astype(np.int64), np.ones((3, 3), np.int64))[1:-1, 1:-1] == 9]
    return max(MAD_TO_SIGMA * float(np.median(response)), QUANTISATION) if response.size else QUANTISATION


def typical_noise(images: Iterable[tuple[np.ndarray, np.ndarray | None]]) -> float:
    """Median of `noise_of` over images (H, W, C) with their masks (H, W) or None."""
    return float(np.median([noise_of(image, valid) for image, valid in images]))
