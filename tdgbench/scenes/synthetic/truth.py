"""The true thermal camera of a synthetic scene, in files beside it that no reader of scenes opens."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_there, read_array, read_json
from tdgbench.scenes.synthetic.capture import TrueRig
from tdgbench.scenes.synthetic.thermal_camera import TrueCamera

FOLDER = "camera"  # inside the scene's
MAPS = ("vignette", "pattern", "dead")
RIG = "rig.json"


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
    """Write `camera/`: numbers of the views as JSON, maps (H, W) in °C as .npy."""
    folder, camera = scene / FOLDER, truth.camera
    folder.mkdir()
    for name in MAPS:
        np.save(folder / f"{name}.npy", getattr(camera, name).astype(np.float32))
    limits = [None] * len(truth.names) if camera.limits is None else camera.limits.tolist()
    views = {
        name: {"offset_degC": float(offset), "gain": float(gain), "limits_degC": limit}
        for name, offset, gain, limit in zip(truth.names, camera.offsets, camera.gains, limits, strict=True)
    }
    content = {"reference_degC": camera.reference, "blur_px": camera.blur_px, "views": views}
    (folder / "camera.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_truth(scene: Path) -> CameraTruth:
    """Read the true camera of a synthetic scene. Raises SceneError for a scene without one, or with damaged files.

    scene: its folder.
    """
    folder = scene / FOLDER
    if not is_there(folder):
        raise SceneError(f"{scene} states no true thermal camera; synthetic scenes do, if their camera has errors")
    maps = {name: read_array(folder / f"{name}.npy") for name in MAPS}
    try:
        content = read_json(folder / "camera.json")
        views = content["views"]
        stated = [view["limits_degC"] for view in views.values()]
        camera = TrueCamera(
            reference=float(content["reference_degC"]),
            offsets=np.array([view["offset_degC"] for view in views.values()], np.float64),
            gains=np.array([view["gain"] for view in views.values()], np.float64),
            blur_px=float(content["blur_px"]),
            limits=None if None in stated else np.array(stated, np.float64),
            **maps,
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SceneError(f"{folder / 'camera.json'} is damaged ({error!r}); delete the scene's folder") from error
    return CameraTruth(list(views), camera)


def write_rig(scene: Path, rig: TrueRig) -> None:
    """Write `camera/rig.json`, beside the errors of the camera."""
    (scene / FOLDER / RIG).write_text(json.dumps(asdict(rig), indent=1) + "\n", encoding="utf-8")


def read_rig(scene: Path) -> TrueRig:
    """Read the true rig of a synthetic scene. Raises SceneError for a scene without one, or with a damaged file.

    scene: its folder.
    """
    path = scene / FOLDER / RIG
    if not is_there(path):
        raise SceneError(f"{scene} states no rig; synthetic scenes do, if their thermal camera is not the given one")
    try:
        return TrueRig(**read_json(path))
    except (ValueError, TypeError) as error:
        raise SceneError(f"{path} is damaged ({error!r}); delete the scene's folder") from error
