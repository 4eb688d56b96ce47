"""Correct a prepared scene for its thermal camera: the training views alone, from what they alone tell."""

from __future__ import annotations

from typing import Literal

import numpy as np
from PIL import Image

from tdgbench.data.prepare.output import SceneWriter
from tdgbench.data.prepare.report import Report
from tdgbench.scenes import Description, ReadOptions, Scene, SceneError
from tdgbench.scenes.read import read_scene
from tdgbench.thermal import ThermalCamera, Unknown, correct_values, estimate_camera

Split = Literal["eighty_twenty", "every_8th"]


def correct_views(views: SceneWriter, split: Split, report: Report) -> None:
    """Estimate the thermal camera of a written scene, and replace the thermal images of its training views.

    Test views stay as they are: their offsets and gains are unknown. Where the camera cannot be estimated, no image is
    changed, and the report says why.
    """
    try:
        scene = read_scene(views.folder, Description("the capture", "folder", ""), ReadOptions(split=split))
    except SceneError as error:
        report.thermal_camera = str(error)
        return
    camera = estimate_camera(scene)
    if isinstance(camera, Unknown):
        report.thermal_camera = camera.reason
        return
    for view in scene.train:
        valid = np.ones((view.camera.height, view.camera.width), bool) if view.valid is None else view.valid
        values = correct_values(_written(views, view.name), view.name, camera)
        views.thermal(view.name, values if views.is_celsius else values[..., None], valid)
    report.thermal_camera = _stated(camera, scene, split)


def _written(views: SceneWriter, name: str) -> np.ndarray:
    """Thermal image (H, W) as written, in °C or in [0, 1]; unlike a scene's, it is not clipped to a range."""
    if views.is_celsius:
        with Image.open(views.folder / "thermal" / f"{name}.tiff") as image:
            return np.asarray(image).astype(np.float64)
    with Image.open(views.folder / "thermal" / f"{name}.png") as image:
        return np.asarray(image).astype(np.float64) / 65535


def _stated(camera: ThermalCamera, scene: Scene, split: Split) -> dict[str, object]:
    """What the report says of a camera: numbers of the training views, and what was done with them."""
    numbers = zip(camera.views, camera.offsets, camera.offset_errors, camera.gains, camera.gain_errors, strict=True)
    return {
        "unit": camera.unit,
        "reference": camera.reference,
        "split": split,
        "views": {
            name: {
                "offset": float(offset),
                "offset_error": float(offset_error),
                "gain": float(gain),
                "gain_error": float(gain_error),
            }
            for name, offset, offset_error, gain, gain_error in numbers
        },
        "vignette": camera.vignette.tolist(),
        "columns": None if camera.columns is None else camera.columns.tolist(),
        "rows": None if camera.rows is None else camera.rows.tolist(),
        "summary": camera.summary,
        "notes": list(camera.notes),
        "applied": (
            f"corrected: the {len(scene.train)} training views of data.split={split}; the {len(scene.test)} test views "
            "are as they were"
        ),
    }
