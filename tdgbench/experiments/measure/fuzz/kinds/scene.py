"""What cases with a mutated scene share: loading it, or a sweep over it and a good scene."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from tdgbench.experiments.measure.fuzz import cells
from tdgbench.experiments.measure.fuzz.case import Kind, Programs
from tdgbench.experiments.measure.fuzz.colmap.compare import differences
from tdgbench.experiments.measure.fuzz.inputs import CELL, GOOD, SCENE, copy_scene
from tdgbench.experiments.measure.fuzz.loaded import load_scene, loaded
from tdgbench.priors import DepthEstimator
from tdgbench.priors.sfm_points import SfmPointsPrior

WHOLE = 0.1  # share of the cases that train, score and write a sweep of two scenes


class SceneKind(Kind):
    """A scene in data/garden that is mutated. Some cases run a whole sweep of it and of data/good."""

    model: ClassVar[str] = "old"
    thermal = "png8"
    words: Sequence[str] = ("method=splat",)

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
