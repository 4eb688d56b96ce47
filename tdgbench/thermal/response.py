"""The response of a thermal camera in image values: correct training views for it, and show renders with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from pydantic import ConfigDict, TypeAdapter, with_config

from tdgbench.scenes import Scene, SceneError, TemperatureRange, View
from tdgbench.thermal.camera import ThermalCamera
from tdgbench.thermal.estimate import units
from tdgbench.thermal.maps import TERMS, evaluate

DIGITS = 7  # of image values, in a record


@with_config(ConfigDict(extra="forbid", allow_inf_nan=False))
@dataclass(frozen=True)
class ImageResponse:
    """Response of a camera in image values, and the range of the images that a model was trained on.

    shown = T + (gain − 1) (T − reference) + offset + vignette(x, y), T = low + (high − low) · render.
    offsets, gains: by view. Test views are not read: their offset is interpolated in the sequence, their gain is 1.
    vignette: (K,) coefficients of `maps`.
    """

    reference: float = 0.0
    offsets: Mapping[str, float] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    vignette: tuple[float, ...] = ()
    low: float = 0.0
    high: float = 1.0

    def __post_init__(self) -> None:
        if len(self.vignette) not in (0, len(TERMS)):
            raise ValueError(f"the vignette of a response has {len(self.vignette)} coefficients, not {len(TERMS)}")
        if not self.low < self.high:
            raise ValueError(f"the range of a response ends at {self.high:g}, not above {self.low:g}")

    def temperatures(self, render: np.ndarray) -> np.ndarray:
        """Return the image (H, W, C) float32 of a render by an ideal camera, not clipped."""
        if (self.low, self.high) == (0.0, 1.0):
            return render
        return np.asarray(self.low + (self.high - self.low) * render, np.float32)

    def shown(self, render: np.ndarray, view: str) -> np.ndarray:
        """Return the image (H, W, C) float32 of a render of a view by this camera, not clipped."""
        values = self.temperatures(render)
        if self.is_ideal:
            return values
        gain = self.gains.get(view, 1.0)
        added = np.full(values.shape[:2], self.offsets.get(view, 0.0) + (1 - gain) * self.reference)
        if self.vignette:
            added += evaluate(np.array(self.vignette), *values.shape[1::-1])
        return np.asarray(gain * values + added[..., None], np.float32)

    @property
    def is_ideal(self) -> bool:
        """Whether the camera has no response of its own."""
        return not (self.offsets or self.gains or self.vignette)

    def as_json(self) -> dict[str, Any]:
        """Return the fields for a record, without empty ones."""
        return {name: value for name, value in asdict(self).items() if value not in ((), {})}


IDEAL = ImageResponse()
ROUNDING = 1e-9  # of image values


def read_response(stated: Mapping[str, Any] | None) -> ImageResponse:
    """Return the response in a record, by default an ideal camera's. Raises ValueError for invalid fields."""
    return TypeAdapter(ImageResponse).validate_python({} if stated is None else stated)


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
    if camera.is_ideal:
        return Corrected(replace(scene, notes=[*scene.notes, "training views stay as they are", *camera.notes]), IDEAL)
    values = {}
    for view in scene.train:
        shown = scale * view.thermal.mean(axis=2, dtype=np.float64) + zero
        values[view.name] = (correct_values(shown, view.name, camera) - zero) / scale
    low, high = _range([values[view.name][... if view.valid is None else view.valid] for view in scene.train])
    span, notes = scene.temperature, [_summary(camera)]
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


def _summary(camera: ThermalCamera) -> str:
    return f"training views are corrected for their thermal camera: {camera.summary}"


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
    low, high = (
        float(ends(1000 * value)) / 1000 for ends, value in ((np.floor, low + ROUNDING), (np.ceil, high - ROUNDING))
    )
    return min(0.0, low), max(1.0, high)


def _image(values: np.ndarray, view: View, scene: Scene) -> np.ndarray:
    """Return the image (H, W, C) of values (H, W); 0 where nothing was measured."""
    if view.valid is not None:
        values = np.where(view.valid, values, 0.0)
    return np.repeat(values[..., None], scene.channels, axis=2).astype(np.float32)
