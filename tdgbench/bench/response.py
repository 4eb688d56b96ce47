"""What a cell does about the thermal camera's response: correct training views, and tell the record what was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tdgbench.scenes import Scene
from tdgbench.thermal import IDEAL, ImageResponse, ThermalCamera, Unknown, corrected, estimate_camera
from tdgbench.thermal.polynomials import evaluate

SPAN_SIZE = 64, 48  # px, of the vignette whose span is told
DIGITS = 6
Facts = dict[str, Any]


@dataclass(frozen=True)
class CameraOptions:
    """What is done about the thermal camera's errors; see `conf/camera/`."""

    estimate: bool  # its response, before training, from sparse points; training views are then corrected
    rig: bool = False  # learn where it is, and its lens, with the Gaussians: `tdgbench.training.rig`


class Prepared(NamedTuple):
    """A scene to train on, facts for the record, notes, response for renders."""

    scene: Scene
    facts: Facts
    notes: list[str]
    response: ImageResponse = IDEAL


def prepare(scene: Scene) -> Prepared:
    """Estimate the camera and correct the training views; where it cannot be estimated, images stay as they are."""
    found = estimate_camera(scene)
    if isinstance(found, Unknown):
        notes = [f"camera: images stay as they are: {found.reason}"]
        return Prepared(scene, {"unknown": found.reason}, notes)
    before = len(scene.notes)
    scene, response = corrected(scene, found)
    notes = [f"camera: {note}" for note in scene.notes[before:]]
    return Prepared(scene, _estimated(found), notes, response)


def _estimated(camera: ThermalCamera) -> Facts:
    pattern = {"columns": camera.columns, "rows": camera.rows}
    return {
        **{name: _rounded(lines) for name, lines in pattern.items() if lines is not None},
        "unit": camera.unit, "terms": list(camera.terms), "undetermined": camera.undetermined,
        "views": list(camera.views), "reference": round(float(camera.reference), DIGITS),
        "offsets": _rounded(camera.offsets), "gains": _rounded(camera.gains), "vignette": _rounded(camera.vignette),
        "offset_rms": round(float(np.sqrt(np.mean(camera.offsets**2))), DIGITS),
        "vignette_span": round(float(np.ptp(evaluate(camera.vignette, *SPAN_SIZE))), DIGITS),
        "residual_before": round(camera.residual_before, 5), "residual_after": round(camera.residual_after, 5),
    }  # fmt: skip


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), DIGITS) for value in values]
