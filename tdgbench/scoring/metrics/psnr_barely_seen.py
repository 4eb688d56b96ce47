"""PSNR of the pixels that the training views hardly determine."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.metrics.barely_seen import is_barely_seen
from tdgbench.scoring.metrics.guess_correlation import seen_pixels
from tdgbench.scoring.metrics.psnr import IN_DB, psnr_of
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView


def psnr_where(shown: ScoredView, barely: bool) -> float:
    """Return the PSNR (dB) over all barely-seen pixels of the test views, or over all others."""
    pixels = seen_pixels(shown)
    errors = pixels.squared_error[is_barely_seen(pixels.determinacy) == barely]
    if not errors.size:
        raise NotApplicableError(f"no pixel of the test views is {'barely' if barely else 'well'} seen")
    return psnr_of(float(errors.mean(dtype=np.float64)))


METRIC = ViewMetric(
    name="psnr_barely_seen",
    label="PSNR, barely seen",
    meaning="PSNR over all barely-seen pixels of the test views",
    order=124,
    **IN_DB,
    needs="Gaussians, barely-seen pixels",
    of_view=lambda shown: psnr_where(shown, barely=True),
)
