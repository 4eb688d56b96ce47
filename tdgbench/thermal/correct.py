"""Correct images for the response of a thermal camera."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from tdgbench.scenes import Scene, SceneError, View
from tdgbench.thermal.camera import ThermalCamera
from tdgbench.thermal.estimate import units

TestViews = Literal["as_is", "shared"]


def correct_values(values: np.ndarray, view: str, camera: ThermalCamera) -> np.ndarray:
    """Temperatures (H, W), or image values, as an ideal camera would show them: the inverse of the response.

    values: (H, W) in the camera's unit. view: the name of a training view; raises KeyError for another one.
    """
    offset, gain = camera.of_view(view)
    height, width = values.shape
    return camera.reference + (values - camera.reference - offset - camera.shared(width, height)) / gain


def corrected(scene: Scene, camera: ThermalCamera, test: TestViews = "as_is") -> Scene:
    """The scene with corrected training views.

    test: what test views get. Their offsets and gains are unknown: `as_is` leaves them as they are, `shared` removes
    what the training views tell about all views, vignette and fixed pattern. The scene keeps its range; values outside
    are clipped, and a note says how many. Its fingerprint is another one, so that nothing made from its images before,
    like depth priors, is taken for it. Raises SceneError for training views that the camera does not know.
    """
    unknown = [view.name for view in scene.train if view.name not in camera.views]
    if unknown:
        raise SceneError(
            f"{scene.name}: the thermal camera was estimated without training view {unknown[0]}; estimate it again"
        )
    train = [
        (view, _image(view, correct_values(_values(view, scene), view.name, camera), scene)) for view in scene.train
    ]
    tested = list(scene.test)
    if test == "shared":
        tested = [_replaced(view, _image(view, _without_shared(view, scene, camera), scene)) for view in scene.test]
    clipped = np.mean([np.mean((image < 0) | (image > 1)) for _, image in train])
    kept = "as they are" if test == "as_is" else "corrected for vignette and fixed pattern alone"
    notes = [
        f"training views are corrected for their thermal camera, test views are {kept}: {camera.summary}",
        *camera.notes,
        f"{clipped:.2%} of the corrected pixels are outside of the image's range and clipped",
    ]
    return replace(
        scene, train=[_replaced(*one) for one in train], test=tested, notes=[*scene.notes, *notes],
        fingerprint=_fingerprint(scene, camera, test),
    )  # fmt: skip


def _fingerprint(scene: Scene, camera: ThermalCamera, test: TestViews) -> str:
    arrays = (camera.offsets, camera.gains, camera.vignette, camera.columns, camera.rows)
    parts = (b"none" if array is None else array.tobytes() for array in arrays)
    return scene.fingerprint_with(test.encode(), str(camera.reference).encode(), *parts)


def _values(view: View, scene: Scene) -> np.ndarray:
    """Values (H, W) of a view in the unit of its scene's camera."""
    _, scale, zero = units(scene)
    return scale * view.thermal.mean(axis=2, dtype=np.float64) + zero


def _without_shared(view: View, scene: Scene, camera: ThermalCamera) -> np.ndarray:
    return _values(view, scene) - camera.shared(view.camera.width, view.camera.height)


def _image(view: View, values: np.ndarray, scene: Scene) -> np.ndarray:
    """Image (H, W, C) of values (H, W), not clipped; 0 where nothing was measured."""
    _, scale, zero = units(scene)
    image = (values - zero) / scale
    if view.valid is not None:
        image = np.where(view.valid, image, 0.0)
    return np.repeat(image[..., None], scene.channels, axis=2).astype(np.float32)


def _replaced(view: View, image: np.ndarray) -> View:
    return view.with_thermal(image.clip(0, 1))
