"""The true thermal camera and rig of a synthetic scene, in files beside it that no reader of scenes opens."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TypeVar

import numpy as np

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_there, read_json, regular_file
from tdgbench.scenes.synthetic.capture import TrueCamera, TrueRig

FOLDER = "camera"  # inside the scene's
CAMERA, RIG = "camera.npz", "rig.json"

T = TypeVar("T")


@dataclass(frozen=True)
class CameraTruth:
    """A camera, and the names of its views (V,)."""

    names: list[str]
    camera: TrueCamera

    def index(self, names: list[str]) -> np.ndarray:
        """Return positions (N,) of views among the camera's."""
        place = {name: number for number, name in enumerate(self.names)}
        return np.array([place[name] for name in names])


def write_truth(scene: Path, truth: CameraTruth) -> None:
    """Write the camera's fields as arrays, of which maps (H, W) are float32. scene: its folder."""
    (scene / FOLDER).mkdir()
    values = {field.name: getattr(truth.camera, field.name) for field in fields(TrueCamera)}
    values |= {name: values[name].astype(np.float32) for name in ("vignette", "pattern")}
    known = {name: value for name, value in values.items() if value is not None}
    np.savez(scene / FOLDER / CAMERA, names=np.array(truth.names), **known)


def read_truth(scene: Path) -> CameraTruth:
    """Read the true camera from a synthetic scene's folder. Raises SceneError if it has none, or a damaged file."""
    return _read(scene / FOLDER / CAMERA, "true thermal camera; synthetic scenes do, if it has errors", _camera)


def write_rig(scene: Path, rig: TrueRig) -> None:
    """Write the rig beside the errors of the camera. scene: its folder."""
    (scene / FOLDER / RIG).write_text(json.dumps(asdict(rig), indent=1) + "\n", encoding="utf-8")


def read_rig(scene: Path) -> TrueRig:
    """Read the true rig from a synthetic scene's folder. Raises SceneError if it has none, or a damaged file."""
    what = "rig; synthetic scenes do, if their thermal camera is not the given one"
    return _read(scene / FOLDER / RIG, what, lambda path: TrueRig(**read_json(path)))


def _camera(path: Path) -> CameraTruth:
    with np.load(regular_file(path), allow_pickle=False) as file:
        stored = dict(file)
    names = stored.pop("names").tolist()
    return CameraTruth(names, TrueCamera(reference=float(stored.pop("reference")), **stored))


def _read(path: Path, what: str, read: Callable[[Path], T]) -> T:
    if not is_there(path):
        raise SceneError(f"{path.parents[1]} states no {what}")
    try:
        return read(path)
    except Exception as error:  # numpy and zipfile raise many kinds
        raise SceneError(f"{path} is damaged ({error!r}); delete the scene's folder") from error
