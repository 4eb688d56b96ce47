"""Everything of a scene that a training starts from: loaded by the product, stored for the oracles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tdgbench.bench.init import ColmapPoints
from tdgbench.priors import DepthEstimator, PriorError
from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tdgbench.scenes.read import LAYOUT_NOTE
from tdgbench.terminal import say

FILE = "loaded.npz"


def load_scene(root: str, scene: str, prior: DepthEstimator) -> int:
    """Load a scene and its priors; store them in FILE. Returns the exit status; errors are printed in one line."""
    try:
        found = FolderDataset(root, ReadOptions()).load(scene)
        content: dict[str, Any] = {
            "points": ColmapPoints().points(found).points,
            "colors": ColmapPoints().points(found).colors,
        }
        content["notes"] = [note for note in found.notes if not note.startswith(LAYOUT_NOTE)]
        content["extent"] = found.extent
        content["names"] = [view.name for view in found.views]
        content["train"] = [view.name for view in found.train]
        content["temperature"] = [] if found.temperature is None else [found.temperature.min, found.temperature.max]
        for view in found.views:
            camera = view.camera
            content[f"K/{view.name}"], content[f"pose/{view.name}"] = camera.K, camera.world_to_camera
            content[f"size/{view.name}"] = [camera.width, camera.height]
            content[f"thermal/{view.name}"] = view.thermal
            content[f"valid/{view.name}"] = np.True_ if view.valid is None else view.valid
            if view.load_rgb is not None:
                content[f"rgb/{view.name}"] = view.rgb
        prior.identity(found)
        for view in found.train:
            content[f"prior/{view.name}"] = prior.estimate(found, view).check(view).values
    except (SceneError, PriorError) as error:
        say(f"error: {error}", stderr=True)
        return 1
    np.savez(FILE, **content)
    return 0


def loaded(folder: Path) -> dict[str, np.ndarray]:
    """What a child stored."""
    with np.load(folder / FILE, allow_pickle=False) as file:
        return dict(file)
