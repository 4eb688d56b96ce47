"""Noise of images, and how much of their spectrum above it a lower resolution shows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import convolve

CERTAIN = 5.0  # times the mean power of noise, which e⁻⁵ of its frequencies exceed
QUANTISATION = 1 / 255 / 12**0.5  # standard deviation of rounding to 8 bits
MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]]) / 6.0  # unit noise has a response of unit variance
MAD_TO_SIGMA = 1.4826  # of a normal distribution


def noise_of(image: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Return the standard deviation of white noise in an image (H, W, C), in its units; at least that of 8 bits.

    The mask of Immerkær (1996, Fast Noise Variance Estimation) has no response to planes and straight steps; the median
    of its absolute response is robust to other edges. valid: bool (H, W); windows with a masked pixel do not
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
    """Return the median of `noise_of` over images (H, W, C) with their masks (H, W) or None."""
    return float(np.median([noise_of(image, valid) for image, valid in images]))


def significant_amplitudes(image: np.ndarray, noise: float, scales: tuple[int, ...]) -> np.ndarray:
    """Return the share (scales,) of an image's amplitudes that its versions 1/scale as large still have; 1 for scale 1.

    The sum of amplitudes below a version's highest frequency, over that of all, is DashGaussian's measure (Chen et al.
    2025). Here only frequencies that stand out of white noise count, and the mean of the image does not.

    image: (H, W, C). noise: standard deviation, in its units. An image that is nothing but noise has 1 at every scale.

    >>> x = np.linspace(0, 8 * np.pi, 64, endpoint=False)
    >>> wave = np.broadcast_to(np.cos(x)[:, None, None], (64, 64, 1))  # 4 periods, 16 px each
    >>> significant_amplitudes(wave, 1e-3, (16, 8, 4, 1)).round(2).tolist()
    [0.0, 0.74, 1.0, 1.0]
    """
    height, width = image.shape[:2]
    window = np.outer(np.hanning(height), np.hanning(width))
    rows, columns = np.fft.fftfreq(height), np.fft.fftfreq(width)
    frequency = np.maximum(np.abs(rows)[:, None], np.abs(columns))  # cycles per px
    amplitudes = np.zeros((height, width))
    for channel in np.moveaxis(image.astype(np.float64), -1, 0):
        power = np.abs(np.fft.fft2((channel - channel.mean()) * window)) ** 2
        amplitudes += np.sqrt(np.where(power > CERTAIN * noise**2 * (window**2).sum(), power, 0.0))
    amplitudes[0, 0] = 0.0
    total = amplitudes.sum()
    if total == 0:
        return np.ones(len(scales))
    return np.array([amplitudes[frequency <= 0.5 / scale].sum() / total if scale > 1 else 1.0 for scale in scales])
