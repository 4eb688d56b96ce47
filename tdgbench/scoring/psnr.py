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


def channel_psnr(image: np.ndarray, target: np.ndarray) -> float:
    """The mean over channels of each channel's PSNR (dB) of images (H, W, C), clipped to [0, 1].

    ThermalGaussian's and 3DGS's `training_report` gives this for float renders; their `metrics.py` pools channels. The
    two are the same for gray images and some tenths to 1 dB apart for pseudo-colour.
    """
    image, target = np.clip(image, 0, 1), np.clip(target, 0, 1)
    return float(np.mean([psnr(image[..., c], target[..., c]) for c in range(image.shape[2])]))
