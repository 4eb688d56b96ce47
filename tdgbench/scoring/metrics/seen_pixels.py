"""Scores of the pixels that the training views hardly determine, and of the others."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.metrics.psnr import IN_DB, psnr_of
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView, as_saved, at_valid
from tdgbench.splats.determinacy import ONE_VIEW

MOST_PIXELS = 1_000_000  # whose ranks are correlated; of more, every n-th is


def is_barely_seen(determinacy: np.ndarray) -> np.ndarray:
    """Return which pixels are determined less than by one training view from the same place.

    >>> is_barely_seen(np.array([0.1, 0.9])).tolist()
    [True, False]
    """
    return determinacy < ONE_VIEW


class SeenPixels(NamedTuple):
    """The valid pixels of all test views: determinacy (N,) and mean squared error over the channels (N,)."""

    determinacy: np.ndarray
    squared_error: np.ndarray


def seen_pixels(shown: ScoredView) -> SeenPixels:
    """Return the pixels of all test views, which the views of one scoring share."""
    if shown.scene is None:
        raise NotApplicableError("training views are what determines the others")
    _ = shown.valid  # a view without valid pixels has no score
    if "seen_pixels" not in shown.common:  # threads that begin at once each find it out
        views = [(view, shown.renders[view.name]) for view in shown.scene.test]
        known = [at_valid(view.valid, rendered.known_determinacy).ravel() for view, rendered in views]
        errors = [
            at_valid(view.valid, np.square(as_saved(rendered.image) - as_saved(view.thermal)).mean(axis=2)).ravel()
            for view, rendered in views
        ]
        shown.common["seen_pixels"] = SeenPixels(np.concatenate(known), np.concatenate(errors))
    pixels: SeenPixels = shown.common["seen_pixels"]
    return pixels


def psnr_where(shown: ScoredView, barely: bool) -> float:
    """Return the PSNR (dB) over all barely-seen pixels of the test views, or over all others."""
    pixels = seen_pixels(shown)
    errors = pixels.squared_error[is_barely_seen(pixels.determinacy) == barely]
    if not errors.size:
        raise NotApplicableError(f"no pixel of the test views is {'barely' if barely else 'well'} seen")
    return psnr_of(float(errors.mean(dtype=np.float64)))


def guess_correlation(determinacy: np.ndarray, error: np.ndarray) -> float:
    """Return Spearman's rank correlation of 1 − determinacy (N,) and error (N,), of at most a million pixels.

    >>> guess_correlation(np.array([0.9, 0.5, 0.1]), np.array([0.0, 0.1, 0.4]))
    1.0
    """
    step = -(-len(error) // MOST_PIXELS)
    some = determinacy[::step], error[::step]
    if any(np.ptp(values) == 0 for values in some):
        raise NotApplicableError("all pixels are determined equally well, or all errors are equal")
    import pandas as pd  # the tables need it as well, where scipy.stats would take half a second more

    ranks = [pd.Series(values).rank() for values in some]
    return -float(np.corrcoef(*ranks)[0, 1])


def _of_all_views(shown: ScoredView) -> float:
    name = "guess_correlation of all views"
    if name not in shown.common:
        shown.common[name] = guess_correlation(*seen_pixels(shown))
    return float(shown.common[name])


BARELY_SEEN = ViewMetric(
    name="barely_seen", label="barely seen",
    meaning="share of pixels that training views determine less than one view from the same place would", order=120,
    has_better_side=False, limits=(0.0, 1.0), needs="Gaussians",
    of_view=lambda shown: float(is_barely_seen(at_valid(shown.valid, shown.rendered.known_determinacy)).mean()),
)  # fmt: skip
PSNR_BARELY_SEEN = ViewMetric(
    name="psnr_barely_seen", label="PSNR, barely seen",
    meaning="PSNR over all barely-seen pixels of the test views: each model's own, so it compares no methods",
    order=124, has_better_side=False, of_all_views=True, **IN_DB,
    needs="Gaussians, barely-seen pixels", of_view=lambda shown: psnr_where(shown, barely=True),
)  # fmt: skip
PSNR_WELL_SEEN = replace(
    PSNR_BARELY_SEEN, name="psnr_well_seen", label="PSNR, well seen",
    meaning="PSNR over the other pixels of the test views: each model's own, so it compares no methods", order=122,
    needs="Gaussians, well-seen pixels", of_view=lambda shown: psnr_where(shown, barely=False),
)  # fmt: skip
GUESS_CORRELATION = ViewMetric(
    name="guess_correlation", label="guesses and errors",
    meaning="rank correlation of 1 − determinacy and the error, over the pixels of all test views", order=126,
    digits=2, has_better_side=False, of_all_views=True, limits=(-1.0, 1.0), needs="Gaussians", of_view=_of_all_views,
)  # fmt: skip
