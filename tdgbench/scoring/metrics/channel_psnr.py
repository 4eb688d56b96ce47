"""PSNR channel by channel, of float renders."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.metrics.psnr import IN_DB, psnr
from tdgbench.scoring.scored_view import ScoredView, at_valid


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


METRIC = ViewMetric(
    name="channel_psnr",
    label="PSNR by channel",
    meaning="mean of the channels' PSNR, of renders that are not rounded to 8 bits",
    order=40,
    **IN_DB,
    of_view=_of_view,
)
