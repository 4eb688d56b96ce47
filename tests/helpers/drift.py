"""Scenes whose training views have known errors of a thermal camera."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tdgbench.scenes import Scene, View
from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.thermal import ThermalCamera
from tdgbench.thermal.camera import normalized_truth
from tdgbench.thermal.maps import evaluate


def with_response(scene: Scene, offsets: np.ndarray, gains: np.ndarray) -> Scene:
    """The scene as a drifting camera shows its training views, in image values; nothing is clipped.

    offsets, gains: (V,) of the training views, about an image value of 0.5.
    """
    train = [_shown(view, *one) for view, *one in zip(scene.train, offsets, gains, strict=True)]
    return replace(scene, train=train)


def _shown(view: View, offset: float, gain: float) -> View:
    image = 0.5 + gain * (view.thermal - 0.5) + offset
    return replace(view, load_thermal=lambda: image.astype(np.float32))


def drift(count: int, size: float, seed: int = 0) -> np.ndarray:
    """Offsets (count,) of mean 0 whose root mean square is `size`."""
    values = np.random.default_rng(seed).normal(size=count)
    values -= values.mean()
    return size * values / np.sqrt(np.mean(values**2))


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
