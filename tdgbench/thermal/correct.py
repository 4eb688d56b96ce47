"""Correct images for the response of a thermal camera."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tdgbench.scenes import Scene, SceneError, TemperatureRange, View
from tdgbench.thermal.camera import ThermalCamera
from tdgbench.thermal.estimate import units
from tdgbench.thermal.maps import evaluate
from tdgbench.thermal.response import ImageResponse

DIGITS = 7  # of image values, in a record


class Corrected(NamedTuple):
    """A scene with corrected training views, and the response to apply to renders."""

    scene: Scene
    response: ImageResponse


def correct_values(values: np.ndarray, view: str, camera: ThermalCamera) -> np.ndarray:
    """Invert the response: temperatures (H, W), or image values, as an ideal camera would show them.

    values: (H, W) in the camera's unit. view: the name of a view; raises KeyError for an unknown one.
    """
    offset, gain = camera.of_view(view)
    height, width = values.shape
    return camera.reference + (values - camera.reference - offset - evaluate(camera.vignette, width, height)) / gain


def corrected(scene: Scene, camera: ThermalCamera) -> Corrected:
    """Correct the training views of a scene; test views stay as they are.

    Nothing is clipped: the range of the training views is widened where corrected values need it, which a note states.
    The scene gets a new fingerprint, so that cached depth priors of the original images are not used. Raises SceneError
    for training views that the camera does not know.
    """
    unknown = [view.name for view in scene.train if view.name not in camera.views]
    if unknown:
        raise SceneError(
            f"{scene.name}: the thermal camera was estimated without training view {unknown[0]}; estimate it again"
        )
    _, scale, zero = units(scene)
    values = {}
    for view in scene.train:
        shown = scale * view.thermal.mean(axis=2, dtype=np.float64) + zero
        values[view.name] = (correct_values(shown, view.name, camera) - zero) / scale
    low, high = _range([values[view.name][... if view.valid is None else view.valid] for view in scene.train])
    span, notes = scene.temperature, [f"training views are corrected for their thermal camera: {camera.summary}"]
    if (low, high) != (0.0, 1.0):
        if span is not None:
            span = TemperatureRange(zero + scale * low, zero + scale * high)
        notes.append(
            f"the corrected values need a range of {zero + scale * low:.4g} to {zero + scale * high:.4g}"
            f"{camera.suffix}, which is 0 to 1 of the images that are trained on; scores are of the given range"
        )
    train = [view.with_thermal(_image((values[view.name] - low) / (high - low), view, scene)) for view in scene.train]
    parts = (array.tobytes() for array in (camera.offsets, camera.gains, camera.vignette))
    fingerprint = scene.fingerprint_with(str(camera.reference).encode(), *parts)
    notes = [*scene.notes, *notes, *camera.notes]
    changed = replace(scene, train=train, temperature=span, notes=notes, fingerprint=fingerprint)
    return Corrected(changed, _response(camera, scale, zero, (low, high)))


def _response(camera: ThermalCamera, scale: float, zero: float, ends: tuple[float, float]) -> ImageResponse:
    of_views = {name: camera.of_view(name) for name in (*camera.views, *camera.expected)}
    return ImageResponse(
        reference=round((camera.reference - zero) / scale, DIGITS),
        offsets={name: round(offset / scale, DIGITS) for name, (offset, _) in of_views.items() if offset},
        gains={name: round(gain, DIGITS) for name, (_, gain) in of_views.items() if gain != 1},
        vignette=tuple(np.round(camera.vignette / scale, DIGITS).tolist()) if camera.vignette.any() else (),
        low=ends[0], high=ends[1],
    )  # fmt: skip


def _range(values: list[np.ndarray]) -> tuple[float, float]:
    """Return the image values that become 0 and 1: 0 and 1, or the extremes of the values (N,) if these lie outside."""
    known = [array for array in values if array.size]
    low, high = min(float(array.min()) for array in known), max(float(array.max()) for array in known)
    return min(0.0, float(np.floor(1000 * low)) / 1000), max(1.0, float(np.ceil(1000 * high)) / 1000)


def _image(values: np.ndarray, view: View, scene: Scene) -> np.ndarray:
    """Return the image (H, W, C) of values (H, W); 0 where nothing was measured."""
    if view.valid is not None:
        values = np.where(view.valid, values, 0.0)
    return np.repeat(values[..., None], scene.channels, axis=2).astype(np.float32)
