"""Peak signal-to-noise ratio."""

from __future__ import annotations

import numpy as np

MAX_PSNR = 100.0  # dB; for equal images, so that means stay finite


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """−10 log10 of the mean squared error over all pixels and channels (dB), images (H, W, C) in [0, 1]."""
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {image.shape} and {target.shape}")
    mse = float(np.mean((image.astype(np.float64) - target.astype(np.float64)) ** 2))
    return MAX_PSNR if mse <= 10 ** (-MAX_PSNR / 10) else -10 * float(np.log10(mse))
