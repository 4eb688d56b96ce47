"""Errors of an estimated thermal camera, where the true one is known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.thermal.camera import ThermalCamera, ViewResponses, normalized


class Truth(NamedTuple):
    """The true camera, normalized as an estimated one is: offsets and gains (V,), what is shared (H, W), in °C."""

    response: ViewResponses
    vignette: np.ndarray
    pattern: np.ndarray


class ThermalCameraErrors(NamedTuple):
    """Estimated minus true: offsets (V,) in °C, gains (V,), vignette (H, W) in °C, fixed pattern (H, W) in °C."""

    offsets: np.ndarray
    gains: np.ndarray
    vignette: np.ndarray
    pattern: np.ndarray


def normalized_truth(truth: CameraTruth, views: Sequence[str], reference: float) -> Truth:
    """Return the true response in some views, with mean offset 0 and mean gain 1 at a reference temperature."""
    true, index = truth.camera, truth.index(list(views))
    gains = true.gains[index]
    offsets = true.offsets[index] + (gains - 1) * (reference - true.reference) + true.vignette.mean()
    response = normalized(ViewResponses(offsets + true.pattern.mean(), gains))
    return Truth(response, true.vignette - true.vignette.mean(), true.pattern - true.pattern.mean())


def errors_of(camera: ThermalCamera, truth: CameraTruth) -> ThermalCameraErrors:
    """Return the errors of an estimate in °C."""
    true = normalized_truth(truth, camera.views, camera.reference)
    height, width = true.vignette.shape
    return ThermalCameraErrors(
        camera.offsets - true.response.offsets,
        camera.gains - true.response.gains,
        camera.map(width, height) - true.vignette,
        camera.pattern(width, height) - true.pattern,
    )
