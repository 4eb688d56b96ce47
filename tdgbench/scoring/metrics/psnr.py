"""Peak signal-to-noise ratio: pooled over the channels of 8-bit pictures, and by channel of float renders."""

from __future__ import annotations

from typing import Any

import numpy as np

from tdgbench.scoring.metric import ImageMetric, ViewMetric
from tdgbench.scoring.scored_view import ScoredView, at_valid

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


def channel_psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Return the mean over channels of each channel's PSNR (dB) of images (…, C), clipped to [0, 1].

    ThermalGaussian's and 3DGS's `training_report` gives this for float renders; their `metrics.py` pools channels. The
    two agree for gray images and are some tenths to 1 dB apart for pseudo-colour.

    >>> target = np.full((4, 4, 2), 0.5)
    >>> round(channel_psnr(target + [0.1, 0.01], target), 6)  # mean of 20 and 40 dB
    30.0
    """
    image, target = np.clip(image, 0, 1), np.clip(target, 0, 1)
    return float(np.mean([psnr(image[..., c], target[..., c]) for c in range(image.shape[-1])]))


def _of_view(shown: ScoredView) -> float:
    return channel_psnr(*(at_valid(shown.valid, image) for image in (shown.rendered.image, shown.view.thermal)))


PSNR = ImageMetric(
    name="psnr", label="PSNR", meaning="peak signal-to-noise ratio, over all channels", order=10, **IN_DB,
    in_main_table=True, of_every_modality=True, on_training_views=True, of_images=lambda pair: psnr(*pair.pixels),
)  # fmt: skip
CHANNEL_PSNR = ViewMetric(
    name="channel_psnr", label="PSNR by channel",
    meaning="mean of the channels' PSNR, of renders that are not rounded to 8 bits", order=40, **IN_DB,
    of_view=_of_view,
)  # fmt: skip
