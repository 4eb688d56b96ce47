"""Errors of temperatures in °C, and PSNR to the true temperatures of built-in scenes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tdgbench.scenes import View
from tdgbench.scenes.images import in_pseudo_colour
from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.metrics.psnr import IN_DB, MAX_PSNR
from tdgbench.scoring.scored_view import NotApplicableError, RenderedImages, ScoredView, at_valid

MIN_MSE = 10 ** (-MAX_PSNR / 10)
SMALLEST = 1e-6  # °C
IN_PALETTE = "the thermal images are pseudo-colour, which is not a linear temperature scale"


def differences(shown: ScoredView) -> np.ndarray:
    """Return differences (N, C) or (H, W, C) of 8-bit pictures in °C, where gray values are linear in temperature."""
    if shown.scene is not None and shown.scene.raw_count_range is not None:
        raise NotApplicableError("raw counts have no °C")
    if shown.scene is not None and shown.scene.in_palette:
        raise NotApplicableError(IN_PALETTE)
    if shown.scene is None or shown.scene.temperature is None:
        raise NotApplicableError("the scene has no temperature range (temperature.json)")
    if in_pseudo_colour([shown.view]):
        raise NotApplicableError(IN_PALETTE)
    image, target = shown.pair("thermal").pixels
    span = shown.scene.temperature.max - shown.scene.temperature.min
    return np.asarray((image - target).astype(np.float64) * span)


def mae_degC(shown: ScoredView) -> float:
    """Return the mean absolute difference in °C."""
    return float(np.abs(differences(shown)).mean())


def mae_degC_without_offset(shown: ScoredView) -> float:
    """Return the mean absolute difference in °C from the median difference, the offset that makes it least."""
    values = differences(shown)
    return float(np.abs(values - np.median(values)).mean())


def psnr_true(shown: ScoredView) -> float:
    """Return the PSNR (dB) of a view's render in °C over valid pixels; the peak is the span of all test views' truth.

    Zero and scale of the scene's temperatures cannot be known from a camera that drifts. So the one gain and the one
    offset that fit the renders of all test views best are applied first.
    """
    scene = shown.scene
    if scene is None:
        raise NotApplicableError("training views have no score against true temperatures")
    if scene.in_palette:
        raise NotApplicableError(IN_PALETTE)
    if any(view.load_true_temperature is None for view in scene.test):
        raise NotApplicableError("the scene has no true temperatures, or its images are not linear in temperature")
    valid = shown.valid
    if PSNR_TRUE.name not in shown.common:  # threads that begin at once each find it out
        shown.common[PSNR_TRUE.name] = _scale(scene.test, shown.renders)
    scale: Scale = shown.common[PSNR_TRUE.name]
    x, y = _pair(shown.view, shown.rendered, valid)
    mse = float(np.mean(np.square(scale.gain * x + scale.offset - y))) / scale.span**2
    return -10 * float(np.log10(max(mse, MIN_MSE)))


class Scale(NamedTuple):
    """°C = gain · rendered value + offset; span of the true temperatures, °C."""

    gain: float
    offset: float
    span: float


def _scale(views: Sequence[View], renders: Mapping[str, RenderedImages]) -> Scale:
    """Return the scale of a scene's renders, and the span of its test views, of which one has a valid pixel."""
    if in_pseudo_colour(views):
        raise NotApplicableError(IN_PALETTE)
    sums, low, high = np.zeros(5), np.inf, -np.inf
    for view in views:  # one after the other: all of them at once are a lot of memory
        x, y = _pair(view, renders[view.name], view.valid)
        if y.size:
            sums += x.size, x.sum(), y.sum(), (x * x).sum(), (x * y).sum()
            low, high = min(low, float(y.min())), max(high, float(y.max()))
    return Scale(*_line(sums), max(high - low, SMALLEST))


def _pair(view: View, rendered: RenderedImages, valid: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the rendered values, not clipped, and true temperatures (N,) of a view's valid pixels."""
    image, truth = rendered.ideal.mean(axis=2, dtype=np.float64), view.true_temperature
    if truth is None or truth.shape != image.shape:
        raise NotApplicableError("the true temperatures have another size than the images")
    return at_valid(valid, image).ravel(), at_valid(valid, truth).ravel().astype(np.float64)


def _line(sums: np.ndarray) -> tuple[float, float]:
    """Return the gain ≥ 0 and offset of the best line, from count, Σx, Σy, Σxx and Σxy."""
    count, of_x, of_y, of_xx, of_xy = sums.tolist()
    spread = of_xx - of_x * of_x / count
    gain = max((of_xy - of_x * of_y / count) / spread, 0.0) if spread > 0 else 1.0
    return gain, (of_y - gain * of_x) / count


MAE_DEGC = ViewMetric(
    name="mae_degC", label="temperature error", meaning="mean absolute error of the temperatures", order=80, unit="°C",
    needs="a temperature range, gray images", verified_to=1e-6, of_view=mae_degC,
)  # fmt: skip
MAE_DEGC_WITHOUT_OFFSET = ViewMetric(
    name="mae_degC_without_offset", label="temperature error without offset",
    meaning="mean absolute error of the temperatures after the offset of each test view that makes it least", order=82,
    unit="°C", fits_to_test_view="offset", needs="a temperature range, gray images", verified_to=1e-6,
    of_view=mae_degC_without_offset,
)  # fmt: skip
PSNR_TRUE = ViewMetric(
    name="psnr_true", label="PSNR to true temperatures",
    meaning="PSNR to the true temperatures after one gain and one offset for all test views", order=44,
    **IN_DB | {"limits": (-math.inf, MAX_PSNR)},  # one bad view may have most of the squared error
    fits_to_test_view="gain and offset, common to all test views", needs="true temperatures, gray images",
    of_view=psnr_true,
)  # fmt: skip
