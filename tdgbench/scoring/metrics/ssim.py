"""Structural similarity (Wang et al. 2004): 11×11 Gaussian window, sigma 1.5, C1 = 0.01², C2 = 0.03², in float64."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d, minimum_filter

from tdgbench.scoring.metric import ImageMetric
from tdgbench.scoring.scored_view import Border, NotApplicableError
from tdgbench.splats.torch_losses import C1, C2, WINDOW, window


def ssim(image: np.ndarray, target: np.ndarray, border: Border, valid: np.ndarray | None = None) -> float:
    """Return the mean SSIM over pixels and channels of images (H, W, C) in [0, 1].

    border `zero`: zeros outside the image, mean over all of it (3DGS). `valid`: only where the window fits
    (scikit-image with gaussian_weights, sigma 1.5, use_sample_covariance=False).

    valid: mask, bool (H, W). Where it is false, pixels are outside the image: `zero` takes zeros there in both images,
    and the mean over the others; `valid` takes the mean where the window holds no such pixel. Raises
    NotApplicableError if it always holds one.

    >>> image = np.linspace(0, 1, 400).reshape(20, 20, 1)
    >>> round(ssim(image, image, "zero"), 6), round(ssim(image, 1 - image, "valid"), 3)
    (1.0, -0.729)
    """
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {image.shape} and {target.shape}")
    half = WINDOW // 2
    if border == "valid" and min(image.shape[:2]) < WINDOW:
        asked = f"{image.shape[1]}×{image.shape[0]}"
        raise NotApplicableError(f"SSIM on the valid region needs {WINDOW}×{WINDOW} px; an image is {asked}")
    a, b = image.astype(np.float64), target.astype(np.float64)
    if valid is not None:
        a, b = (np.where(valid[..., None], pixels, 0.0) for pixels in (a, b))
    mu_a, mu_b = _blur(a), _blur(b)
    var_a, var_b = _blur(a * a) - mu_a**2, _blur(b * b) - mu_b**2
    covariance = _blur(a * b) - mu_a * mu_b
    values = ((2 * mu_a * mu_b + C1) * (2 * covariance + C2)) / ((mu_a**2 + mu_b**2 + C1) * (var_a + var_b + C2))
    if valid is not None:
        values = values[valid if border == "zero" else _fits(valid)]
    elif border == "valid":
        values = values[half:-half, half:-half]
    return float(values.mean())


def _fits(valid: np.ndarray) -> np.ndarray:
    """Return where the window around a pixel holds only pixels of the image at which the mask (H, W) is true."""
    fits = minimum_filter(valid.astype(np.uint8), size=WINDOW, mode="constant", cval=0) > 0
    if not fits.any():
        raise NotApplicableError(f"no window of {WINDOW}×{WINDOW} px holds only pixels with a thermal value")
    return fits


def _blur(image: np.ndarray) -> np.ndarray:
    weights = window()
    rows = correlate1d(image, weights, axis=0, mode="constant")
    return correlate1d(rows, weights, axis=1, mode="constant")


SSIM = ImageMetric(
    name="ssim", label="SSIM", meaning="structural similarity", order=20,
    overall_digits=4,  # as the paper prints its overall average
    higher_is_better=True, limits=(-1.0, 1.0), in_main_table=True, of_every_modality=True, on_training_views=True,
    options=("ssim_border",),
    of_images=lambda pair: ssim(pair.image, pair.target, pair.convention.ssim_border, pair.valid),
)  # fmt: skip
