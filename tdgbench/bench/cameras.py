"""`cameras.json`: the cameras of a cell, to render its model again and count coverage without the data."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tdgbench.bench.reading import read_text
from tdgbench.files import write_text
from tdgbench.scenes import Camera, Scene, SceneError
from tdgbench.scenes.validate import check_camera
from tdgbench.text import shortened

FILE = "cameras.json"
Cameras = dict[str, dict[str, Camera]]  # by part, `train` or `test`, and view


def write_cameras(path: Path, scene: Scene) -> None:
    """Write the cameras of all training and test views."""
    parts = {"train": scene.train, "test": scene.test}
    cameras = {part: {view.name: _as_json(view.camera) for view in views} for part, views in parts.items()}
    write_text(path, json.dumps(cameras, indent=1) + "\n")


def read_cameras(path: Path, part: Literal["train", "test"]) -> dict[str, Camera]:
    """Read the cameras of one part, by view name. Raises ValueError, naming the file, if it holds anything else."""
    with _parsing(path):
        return _of_part(json.loads(read_text(path)), part)


def read_all_cameras(folder: Path) -> Cameras:
    """The cameras of the parts `train` and `test`. Raises ValueError for a camera that cannot be right."""
    path = folder / FILE
    text = read_text(path)
    with _parsing(path):
        content = json.loads(text)
        found: Cameras = {part: _of_part(content, part) for part in ("train", "test")}
    for name, camera in [*found["train"].items(), *found["test"].items()]:
        if Path(name).name != name or "\0" in name:
            raise ValueError(f"{shortened(repr(name), 60)} is no name of a view")
        try:
            check_camera(camera, f"the camera of {name}")
        except SceneError as error:
            raise ValueError(str(error)) from error
    return found


@contextmanager
def _parsing(path: Path) -> Iterator[None]:
    """Turn errors of a content that is no cameras into ValueError, naming the file."""
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise ValueError(f"{path} holds no cameras: {error!r}") from error


def _of_part(content: Any, part: str) -> dict[str, Camera]:
    return {name: _from_json(one) for name, one in content[part].items()}


def _as_json(camera: Camera) -> dict[str, object]:
    return {
        "K": camera.K.tolist(),
        "world_to_camera": camera.world_to_camera.tolist(),
        "width": camera.width,
        "height": camera.height,
    }


def _from_json(content: dict[str, object]) -> Camera:
    return Camera(
        np.array(content["K"], np.float64).reshape(3, 3),
        np.array(content["world_to_camera"], np.float64).reshape(4, 4),
        int(content["width"]),  # type: ignore[call-overload]
        int(content["height"]),  # type: ignore[call-overload]
    )
