"""Errors of an estimated thermal camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.thermal import ThermalCamera
from tdgbench.thermal.camera import normalized_truth
from tdgbench.thermal.maps import evaluate


class CameraErrors(NamedTuple):
    """Estimated minus true: offsets (V,) in °C, gains (V,), vignette (H, W) in °C."""

    offsets: np.ndarray
    gains: np.ndarray
    vignette: np.ndarray


def errors_of(camera: ThermalCamera, truth: CameraTruth) -> CameraErrors:
    """Errors of an estimate."""
    true = normalized_truth(truth, camera.views, camera.reference)
    height, width = true.vignette.shape
    return CameraErrors(
        camera.offsets - true.response.offsets,
        camera.gains - true.response.gains,
        evaluate(camera.vignette, width, height) - true.vignette,
    )
