"""Peak signal-to-noise ratio."""

from __future__ import annotations

from typing import Any

import numpy as np

from tdgbench.scoring.metric import ImageMetric

MAX_PSNR = 100.0  # dB; of equal images, so that means stay finite
IN_DB: dict[str, Any] = {"unit": "dB", "digits": 2, "higher_is_better": True, "limits": (0.0, MAX_PSNR)}


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Return −10 log10 of the mean squared error over all pixels and channels (dB), images (…, C) in [0, 1].

    >>> round(psnr(np.full((4, 4, 1), 0.6), np.full((4, 4, 1), 0.5)), 6)
    20.0
    """
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {image.shape} and {target.shape}")
    return psnr_of(float(np.mean((image.astype(np.float64) - target.astype(np.float64)) ** 2)))


def psnr_of(mse: float) -> float:
    """Return the PSNR (dB) of a mean squared error of values in [0, 1].

    >>> psnr_of(0.01), psnr_of(0.0)
    (20.0, 100.0)
    """
    return MAX_PSNR if mse <= 10 ** (-MAX_PSNR / 10) else -10 * float(np.log10(mse))


METRIC = ImageMetric(
    name="psnr",
    label="PSNR",
    meaning="peak signal-to-noise ratio, over all channels",
    order=10,
    **IN_DB,
    in_main_table=True,
    of_every_modality=True,
    on_training_views=True,
    of_images=lambda pair: psnr(*pair.pixels),
)
