"""What displacements of an image's pixels change."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

LARGEST_STEP = 0.5  # px², variance along each axis that a kernel of three taps has
SMOOTH = 2.0  # px², variance from which a sampled Gaussian is exact enough


def displaced(values: np.ndarray, valid: np.ndarray | None, variance: float) -> np.ndarray:
    """Mean (H, W) of each pixel's value over random displacements, with variance px² along each axis.

    values: (H, W). valid: (H, W) bool or None (all pixels); the mean is over valid pixels.
    """
    values = values.astype(np.float64)
    if variance <= 0:
        return values
    if valid is None:
        return _diffused(values, variance)
    total = _diffused(np.where(valid, values, 0.0), variance)
    return total / np.maximum(_diffused(valid.astype(np.float64), variance), 1e-9)


def spread_by_displacement(image: np.ndarray, valid: np.ndarray | None, variance: float) -> np.ndarray:
    """Variance (H, W) of each pixel's value over random displacements, as `displaced`.

    With k the distribution of displacements, this is k ∗ I² − (k ∗ I)².

    >>> step = np.repeat([0.0, 1.0], 3)[None].repeat(3, axis=0)
    >>> spread_by_displacement(step, None, 0.2)[0].round(2).tolist()
    [0.0, 0.0, 0.09, 0.09, 0.0, 0.0]
    """
    square = image.astype(np.float64) ** 2
    return np.maximum(displaced(square, valid, variance) - displaced(image, valid, variance) ** 2, 0)


def _diffused(values: np.ndarray, variance: float) -> np.ndarray:
    if variance >= SMOOTH:
        return ndimage.gaussian_filter(values, variance**0.5, mode="nearest")
    steps = max(1, int(np.ceil(variance / LARGEST_STEP)))
    kernel, side = np.array([1.0]), variance / steps / 2
    for _ in range(steps):
        kernel = np.convolve(kernel, [side, 1 - 2 * side, side])
    for axis in (0, 1):
        values = ndimage.correlate1d(values, kernel, axis, mode="nearest")
    return values
