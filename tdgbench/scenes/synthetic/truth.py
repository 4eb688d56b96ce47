"""The true thermal camera and rig of a synthetic scene, in files beside it that no reader of scenes opens."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tdgbench.files import opened
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import decoding, is_there, read_json, regular_file
from tdgbench.scenes.synthetic.capture import TrueCamera, TrueRig

FOLDER = "camera"  # inside the scene's
CAMERA, RIG = "camera.npz", "rig.json"
REMEDY = "delete the scene's folder"


@dataclass(frozen=True)
class CameraTruth:
    """A camera, and the names of its views (V,)."""

    names: list[str]
    camera: TrueCamera

    def index(self, names: list[str]) -> np.ndarray:
        """Return positions (N,) of views among the camera's."""
        return np.array([self.names.index(name) for name in names])


def write_truth(scene: Path, truth: CameraTruth, rig: TrueRig) -> None:
    """Write the camera's fields as arrays, maps (H, W) in float32, and a rig, if there is one. scene: its folder."""
    (scene / FOLDER).mkdir()
    known = {name: value for name, value in vars(truth.camera).items() if value is not None}
    known |= {name: known[name].astype(np.float32) for name in ("vignette", "pattern")}
    np.savez(scene / FOLDER / CAMERA, names=np.array(truth.names), **known)
    if rig != TrueRig():
        (scene / FOLDER / RIG).write_text(json.dumps(asdict(rig), indent=1) + "\n", encoding="utf-8")


def read_truth(scene: Path) -> CameraTruth:
    """Read the true camera from a synthetic scene's folder. Raises SceneError if it has none, or a damaged file."""
    path = _stated(scene, CAMERA)
    with decoding(path, "a true camera", REMEDY), opened(path) as content, np.load(content, allow_pickle=False) as file:
        stored = dict(file)
        names = stored.pop("names").tolist()
        return CameraTruth(names, TrueCamera(reference=float(stored.pop("reference")), **stored))


def read_rig(scene: Path) -> TrueRig:
    """Read the true rig from a synthetic scene's folder. Raises SceneError if it has none, or a damaged file."""
    path = _stated(scene, RIG)
    with decoding(path, "a rig", REMEDY):
        return TrueRig(**read_json(path))


def _stated(scene: Path, name: str) -> Path:
    if not is_there(path := scene / FOLDER / name):
        raise SceneError(f"{scene} has no {FOLDER}/{name}; synthetic scenes do, if their thermal camera is not ideal")
    return regular_file(path)
