"""`cameras.json`: the cameras of a cell, to render its model again without the data."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tdgbench.cells.paths import CAMERAS_FILE
from tdgbench.cells.read_files import MAX_CAMERAS, MOST_PIXELS, read_text
from tdgbench.files import write_text
from tdgbench.scenes import Camera, Scene, SceneError
from tdgbench.scenes.camera import check_camera
from tdgbench.text import shortened

Cameras = dict[str, dict[str, Camera]]  # by part, `train` or `test`, and view


def write_cameras(folder: Path, scene: Scene) -> None:
    """Write the cameras of all training and test views."""
    parts = {"train": scene.train, "test": scene.test}
    cameras = {part: {view.name: _as_json(view.camera) for view in views} for part, views in parts.items()}
    write_text(folder / CAMERAS_FILE, json.dumps(cameras, indent=1) + "\n")


def read_cameras(folder: Path) -> Cameras:
    """Read the cameras of a cell. Raises ValueError, naming the file or the view, if it holds anything else."""
    path = folder / CAMERAS_FILE
    try:
        content = json.loads(read_text(path, MAX_CAMERAS))
        found: Cameras = {
            part: {name: _from_json(camera) for name, camera in content[part].items()} for part in ("train", "test")
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise ValueError(f"{path} holds no cameras: {error!r}") from error
    for name, camera in [*found["train"].items(), *found["test"].items()]:
        if Path(name).name != name or "\0" in name:
            raise ValueError(f"{shortened(repr(name), 60)} is no name of a view")
        if camera.width * camera.height > MOST_PIXELS:
            raise ValueError(f"the camera of {name} has {camera.width}×{camera.height} px, more than {MOST_PIXELS}")
        try:
            check_camera(camera, f"the camera of {name}")
        except SceneError as error:
            raise ValueError(str(error)) from error
    return found


def _as_json(camera: Camera) -> dict[str, object]:
    return {
        "K": camera.K.tolist(),
        "world_to_camera": camera.world_to_camera.tolist(),
        "width": camera.width,
        "height": camera.height,
    }


def _from_json(content: dict[str, Any]) -> Camera:
    K = np.array(content["K"], np.float64).reshape(3, 3)
    pose = np.array(content["world_to_camera"], np.float64).reshape(4, 4)
    return Camera(K, pose, int(content["width"]), int(content["height"]))
