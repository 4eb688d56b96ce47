"""How much of images a lower resolution shows: amplitudes of their spectra above noise."""

from __future__ import annotations

import numpy as np

CERTAIN = 5.0  # times the mean power of noise, which e⁻⁵ of its frequencies exceed


def significant_amplitudes(image: np.ndarray, noise: float, scales: tuple[int, ...]) -> np.ndarray:
    """Share (scales,) of an image's amplitudes that its versions 1/scale as large still have; 1 for scale 1.

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
