"""What a cell does about the thermal camera's response: correct training views, and tell the record what was found."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tdgbench.scenes import Scene
from tdgbench.thermal import ThermalCamera, Unknown, corrected, estimate_camera
from tdgbench.thermal.estimate import units
from tdgbench.training.camera import IdealCamera, RefinedCamera

TINY = 1e-9  # °C or image values; a smaller term was not estimated
Facts = dict[str, Any]


class Corrected(NamedTuple):
    """A scene with corrected training views; facts for the record; notes."""

    scene: Scene
    facts: Facts
    notes: list[str]


def correct_training_views(scene: Scene) -> Corrected:
    """Correct the training views by the estimated camera; if it cannot be estimated, a note says why and none is."""
    found = estimate_camera(scene)
    if isinstance(found, Unknown):
        return Corrected(scene, {"unknown": found.reason}, [f"camera: images stay as they are: {found.reason}"])
    better = corrected(scene, found)
    return Corrected(better, _estimated(found), [f"camera: {note}" for note in better.notes[len(scene.notes) :]])


def refined_facts(camera: IdealCamera, scene: Scene) -> Facts:
    """What training learned about the camera, in °C where the scene has temperatures; empty if it learned nothing."""
    if not isinstance(camera, RefinedCamera):
        return {"unknown": camera.reason} if camera.reason else {}
    unit, scale, _ = units(scene)
    first = scene.train[0].camera
    vignette = scale * camera.map(first.width, first.height)
    return {"unit": unit, **_summary(scale * camera.offsets, camera.gains, vignette)}


def _estimated(camera: ThermalCamera) -> Facts:
    vignette = camera.map(64, 48)
    parts = {
        "offsets": camera.offsets, "gains": camera.gains - 1, "vignette": vignette, "columns": camera.columns,
        "rows": camera.rows,
    }  # fmt: skip
    terms = [name for name, values in parts.items() if values is not None and np.abs(values).max() > TINY]
    return {
        "unit": camera.unit, "terms": terms, **_summary(camera.offsets, camera.gains, vignette),
        "residual_before": round(camera.residual_before, 5), "residual_after": round(camera.residual_after, 5),
    }  # fmt: skip


def _summary(offsets: np.ndarray, gains: np.ndarray, vignette: np.ndarray) -> Facts:
    """Offsets (V,) and vignette (H, W) in the scene's unit."""
    return {
        "offset_rms": round(float(np.sqrt(np.mean(offsets**2))), 5),
        "offset_range": [round(float(offsets.min()), 5), round(float(offsets.max()), 5)],
        "gain_range": [round(float(gains.min()), 5), round(float(gains.max()), 5)],
        "vignette_span": round(float(np.ptp(vignette)), 5),
    }
