"""PSNR to the true temperatures, which are known of made scenes: what a thermal camera's errors cost a model."""

from __future__ import annotations

import numpy as np

from tdgbench.scenes.images import is_gray
from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.metrics.psnr import MAX_PSNR
from tdgbench.scoring.metrics.psnr_affine import Response, best_response
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView

MIN_MSE = 10 ** (-MAX_PSNR / 10)


def psnr_true(shown: ScoredView) -> float:
    """PSNR (dB) of a view's render in °C, with the span of the true temperatures of all test views as its peak.

    Zero and scale of the scene's temperatures cannot be known from a camera that drifts. So the one gain and the one
    offset that fit the renders of all test views best are applied first.
    """
    scene = shown.scene
    if scene is None:
        raise NotApplicableError("training views have no score against true temperatures")
    truth = {view.name: view.true_temperature for view in scene.test}
    known = {name: one.astype(np.float64) for name, one in truth.items() if one is not None}
    if len(known) < len(truth):
        raise NotApplicableError("the scene has no true temperatures")
    if not all(is_gray(view.thermal) for view in scene.test):
        raise NotApplicableError("the thermal images are pseudo-colour, which is not a linear temperature scale")
    if any(one.shape != shown.renders[name].image.shape[:2] for name, one in known.items()):
        raise NotApplicableError("the true temperatures have another size than the images")
    low, high = min(one.min() for one in known.values()), max(one.max() for one in known.values())
    response = _of_all({name: _gray(shown.renders[name].image) for name in known}, known)
    error = response.gain * _gray(shown.rendered.image) + response.offset - known[shown.view.name]
    mse = float(np.mean(np.square(error))) / (high - low) ** 2
    return -10 * float(np.log10(max(mse, MIN_MSE)))


def _gray(image: np.ndarray) -> np.ndarray:
    """Mean over the channels (H, W) of a render, clipped as its picture is."""
    return image.clip(0, 1).mean(axis=2, dtype=np.float64)


def _of_all(images: dict[str, np.ndarray], targets: dict[str, np.ndarray]) -> Response:
    return best_response(*(np.concatenate([one.ravel() for one in maps.values()]) for maps in (images, targets)))


METRIC = ViewMetric(
    name="psnr_true",
    label="PSNR to true temperatures",
    meaning="PSNR to the true temperatures after one gain and one offset for all test views",
    order=44,
    unit="dB",
    digits=2,
    higher_is_better=True,
    limits=(0.0, MAX_PSNR),
    needs="true temperatures, gray images",
    of_view=psnr_true,
)
