"""Errors of an estimated thermal camera, where the true one is known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.thermal.camera import Response, ThermalCamera, in_gauge


class Truth(NamedTuple):
    """The true camera in the gauge of an estimated one: offsets and gains (V,), what is shared (H, W), in °C."""

    response: Response
    vignette: np.ndarray
    pattern: np.ndarray


class Errors(NamedTuple):
    """Estimated minus true: offsets (V,) in °C, gains (V,), vignette (H, W) in °C, fixed pattern (H, W) in °C."""

    offsets: np.ndarray
    gains: np.ndarray
    vignette: np.ndarray
    pattern: np.ndarray


def truth_in_gauge(truth: CameraTruth, camera: ThermalCamera) -> Truth:
    """The true response of the estimated camera's views, with mean offset 0 and mean gain 1 at its reference."""
    true, views = truth.camera, truth.index(list(camera.views))
    gains = true.gains[views]
    offsets = true.offsets[views] + (gains - 1) * (camera.reference - true.reference) + true.vignette.mean()
    response = in_gauge(Response(offsets + true.pattern.mean(), gains))
    return Truth(response, true.vignette - true.vignette.mean(), true.pattern - true.pattern.mean())


def errors_of(camera: ThermalCamera, truth: CameraTruth) -> Errors:
    """Errors of an estimate in °C."""
    true = truth_in_gauge(truth, camera)
    height, width = true.vignette.shape
    return Errors(
        camera.offsets - true.response.offsets,
        camera.gains - true.response.gains,
        camera.map(width, height) - true.vignette,
        camera.pattern(width, height) - true.pattern,
    )
