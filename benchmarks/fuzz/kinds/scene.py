"""Scenes that are mutated: what their kinds share, and what the product loads of them, stored for the oracles."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.fuzz import cells
from benchmarks.fuzz.case import Kind, Programs
from benchmarks.fuzz.colmap_files import read
from benchmarks.fuzz.colmap_model import MalformedError
from benchmarks.fuzz.inputs import CELL, GOOD, SCENE, copy_scene
from tdgbench.bench.init import ColmapPoints
from tdgbench.priors import DepthEstimator, PriorError
from tdgbench.priors.sfm_points import SfmPointsPrior
from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tdgbench.terminal import say

FILE = "loaded.npz"
WHOLE = 0.1  # share of the cases that train, score and write a sweep of two scenes


def load_scene(root: str, scene: str, prior: DepthEstimator) -> int:
    """Load a scene and its priors; store them in FILE. Returns the exit status; errors are printed in one line."""
    try:
        found = FolderDataset(root, ReadOptions()).load(scene)
        content: dict[str, Any] = {
            "points": ColmapPoints().points(found).points,
            "colors": ColmapPoints().points(found).colors,
        }
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


class SceneKind(Kind):
    """A scene in data/garden that is mutated. Some cases run a whole sweep of it and of data/good."""

    model: ClassVar[str] = "old"
    thermal = "png8"
    words: Sequence[str] = ("method=3dgs",)

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        self.whole = rng.random() < WHOLE
        self.scene = folder / "data" / SCENE
        copy_scene(base, self.scene, self.thermal, self.model)
        if self.whole:
            copy_scene(base, folder / "data" / GOOD)

    def prior(self) -> DepthEstimator:
        """The estimator whose maps are loaded, too."""
        return SfmPointsPrior(160, 0.05, 0.05, 0.1)

    def run(self, programs: Programs) -> int:
        if not self.whole:
            return load_scene("data", SCENE, self.prior())
        words = ["-m", *CELL, *self.words, f"scene={SCENE},{GOOD}"]
        return cells.command_and_verify(programs, words, "out/single")

    def lost(self) -> str:
        return cells.outputs_lost(self.folder / "out" / "single", GOOD) if self.whole else ""

    def wrong(self) -> str:
        if self.whole:  # what it would have loaded; then what it wrote
            return self.wrong_on_disk() or cells.unverified(self.folder)
        found = loaded(self.folder)
        return self.wrong_cameras(found) or self.wrong_values(found)

    def wrong_cameras(self, found: dict) -> str:
        """Why loaded cameras or points are wrong."""
        return differences(self.scene / "sparse" / "0", found)

    def records(self, scene: str) -> list[dict[str, Any]]:
        """Records of a scene's cells."""
        return [one for one in cells.records(self.folder / "out" / "single") if one.get("scene") == scene]

    def wrong_on_disk(self) -> str:
        """Why no result can be right for the files of the scene."""
        return ""

    def wrong_values(self, found: dict) -> str:
        """Why loaded images, priors or temperatures are wrong."""
        return ""


def differences(folder: Path, found: dict[str, np.ndarray]) -> str:
    """Why loaded cameras and points (see `load_scene`) cannot be right for the model in a folder; empty if they are."""
    try:
        model = read(folder)
    except MalformedError as error:
        return f"loaded, but the model is malformed: {error}"
    problems = model.problems()
    if problems:
        return f"loaded, but the model is unusable: {problems[0]}"
    cameras = {camera.id: camera for camera in model.cameras}
    by_view = {image.view: image for image in model.images}
    for view in found["names"].tolist():
        if view not in by_view:
            return f"loaded view {view}, which the model does not have"
        image = by_view[view]
        camera, K = cameras[image.camera], found[f"K/{view}"]
        if not np.isfinite(K).all() or not np.allclose(found[f"pose/{view}"], model.pose(image), rtol=1e-9, atol=1e-9):
            return f"the pose of {view} differs from the model's"
        if camera.matrix is not None and not np.allclose(K, camera.matrix, rtol=1e-9):
            return f"K of {view} differs from the model's"
        if camera.matrix is not None and found[f"size/{view}"].tolist() != [camera.width, camera.height]:
            return f"the size of {view} differs from the model's"
    points = np.array([p.xyz for p in sorted(model.points, key=lambda p: p.id)])
    if points.shape != found["points"].shape or not np.allclose(points, found["points"], rtol=1e-9):
        return "the points differ from the model's"
    return ""
