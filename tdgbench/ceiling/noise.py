"""Noise of the pixels of an image, from the image itself."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tdgbench.ceiling.images import blurred

BINS = 8  # of brightness: noise may depend on it, as under a palette
FLAT = 0.3  # share of a bin's pixels that are the flattest
SMOOTHING = 1.5  # px, σ of the blur that flatness is judged at
PIXELS = 80_000  # of an image that are looked at
OUTLIER = 4.0  # standard deviations
SECOND = np.array([1.0, -2.0, 1.0])
ENERGY = 36.0  # sum of the squares of the mask SECOND × SECOND


def noise_variance(image: np.ndarray, valid: np.ndarray | None) -> float:
    """Variance of the noise of an image (H, W), a mean over its valid pixels.

    The mask of second differences in x and y (Immerkær 1996, Fast Noise Variance Estimation) removes what is linear in
    either; it is squared and averaged over the flattest pixels of each brightness, without outliers.
    """
    detail = ndimage.correlate1d(ndimage.correlate1d(image, SECOND, 0), SECOND, 1)
    smooth = blurred(image, valid, SMOOTHING)
    steepness = np.square(np.gradient(smooth)).sum(axis=0)
    usable = np.ones(image.shape, bool) if valid is None else ndimage.binary_erosion(valid, iterations=4)
    step = int(np.ceil(np.sqrt(image.size / PIXELS)))
    some = (slice(2, -2, step), slice(2, -2, step))
    usable = usable[some]
    square, steep, bright = (a[some][usable] for a in (detail**2 / ENERGY, steepness, smooth))
    if not len(square):
        return 0.0
    edges = np.unique(np.quantile(bright, np.linspace(0, 1, BINS + 1)[1:-1]))
    bins = np.digitize(bright, edges)
    return sum(np.mean(bins == one) * _flat_mean(square[bins == one], steep[bins == one]) for one in np.unique(bins))


def _flat_mean(square: np.ndarray, steep: np.ndarray) -> float:
    """Mean of `square` (N,) over the flattest pixels, without outliers."""
    flat = square[steep <= np.quantile(steep, FLAT)]
    for _ in range(3):
        kept = flat[flat <= OUTLIER**2 * flat.mean()]
        flat = kept if len(kept) else flat
    return float(flat.mean())
