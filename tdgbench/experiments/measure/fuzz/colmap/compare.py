"""Compare loaded cameras and points with the model on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tdgbench.experiments.measure.fuzz.colmap import binary, text
from tdgbench.experiments.measure.fuzz.colmap.model import MalformedError, Model


def read(folder: Path) -> Model:
    """The model in a folder: binary if it has a binary file, else text, as COLMAP chooses. Raises MalformedError."""
    return (binary if (folder / "cameras.bin").exists() else text).read(folder)


def differences(folder: Path, loaded: dict[str, np.ndarray]) -> str:
    """Why loaded cameras and points (see loaded.py) cannot be right for the model in a folder; empty if they are."""
    try:
        model = read(folder)
    except MalformedError as error:
        return f"loaded, but the model is malformed: {error}"
    problems = model.problems()
    if problems:
        return f"loaded, but the model is unusable: {problems[0]}"
    doubts = [] if loaded["notes"].size else model.doubts()
    if doubts:
        return f"loaded without a note, but the model is doubtful: {doubts[0]}"
    cameras = {camera.id: camera for camera in model.cameras}
    by_view = {image.view: image for image in model.images}
    for view in loaded["names"].tolist():
        if view not in by_view:
            return f"loaded view {view}, which the model does not have"
        image = by_view[view]
        camera, K = cameras[image.camera], loaded[f"K/{view}"]
        if not np.isfinite(K).all() or not np.allclose(loaded[f"pose/{view}"], model.pose(image), rtol=1e-9, atol=1e-9):
            return f"the pose of {view} differs from the model's"
        if camera.matrix is not None and not np.allclose(K, camera.matrix, rtol=1e-9):
            return f"K of {view} differs from the model's"
        if camera.matrix is not None and loaded[f"size/{view}"].tolist() != [camera.width, camera.height]:
            return f"the size of {view} differs from the model's"
    points = np.array([p.xyz for p in sorted(model.points, key=lambda p: p.id)])
    if points.shape != loaded["points"].shape or not np.allclose(points, loaded["points"], rtol=1e-9):
        return "the points differ from the model's"
    return ""
