"""Constants of SSIM (Wang et al. 2004), for images in [0, 1]: the fused kernels, torch and the metric share them."""

from __future__ import annotations

import numpy as np

WINDOW, SIGMA = 11, 1.5  # px: side and standard deviation of the Gaussian window
C1, C2 = 0.01**2, 0.03**2


def window() -> np.ndarray:
    """Return weights float64 (11,) of the separable window.

    >>> window().round(3)[:6]
    array([0.001, 0.008, 0.036, 0.109, 0.213, 0.266])
    """
    offsets = np.arange(WINDOW) - WINDOW // 2
    weights = np.exp(-(offsets**2) / (2 * SIGMA**2))
    return weights / weights.sum()
