"""The synthetic scenes as a data set: written at first use, then read like any other."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

from pydantic import Field, NonNegativeInt

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import check_scene_name
from tdgbench.scenes.layouts import LAYOUTS
from tdgbench.scenes.options import Description, FolderPath, ReadOptions
from tdgbench.scenes.read import Outline, outline_scene
from tdgbench.scenes.scene import Scene
from tdgbench.scenes.synthetic.capture import CaptureErrors
from tdgbench.scenes.synthetic.worlds import WORLDS
from tdgbench.scenes.synthetic.write import Shot, write_scene


class SyntheticDataset:
    """Scenes in <root>/synthetic/, one folder per name, size, number of views and points, seed, and errors.

    width, height: of the images, px. views: cameras per scene. points: sparse points per scene. errors: of the capture.

    >>> SyntheticDataset("data", ReadOptions()).names()
    ['orbit', 'night', 'turntable', 'facade', 'field', 'hills', 'wall']
    """

    def __init__(
        self,
        root: FolderPath,
        options: ReadOptions,
        width: Annotated[int, Field(ge=8, le=4096)] = 160,
        height: Annotated[int, Field(ge=8, le=4096)] = 120,
        views: Annotated[int, Field(ge=2, le=1000)] = 40,
        points: NonNegativeInt = 4000,
        seed: NonNegativeInt = 0,
        errors: CaptureErrors | None = None,
    ) -> None:
        self.root = Path(root)
        self.options = options
        self.shot = Shot(width, height, views, points, seed, errors or CaptureErrors())

    def names(self) -> list[str]:
        return list(WORLDS)

    def missing(self, names: list[str]) -> list[str]:
        return [name for name in names if name not in WORLDS]

    def explain_missing(self, names: list[str]) -> str:
        return f"no synthetic scene {', '.join(names)}; choose from {', '.join(WORLDS)}"

    def describe(self, name: str | None) -> Description:
        name = next(iter(WORLDS)) if name is None else check_scene_name(name)
        if name not in WORLDS:
            raise SceneError(self.explain_missing([name]))
        title = "synthetic_degC" if self.shot.errors.camera.encoding == "degC" else "synthetic"
        return Description(name, title, WORLDS[name](self.shot.seed).group)

    def load(self, name: str | None) -> Scene:
        return self.outline(name).read()

    def outline(self, name: str | None) -> Outline:
        description = self.describe(name)
        world = WORLDS[description.scene](self.shot.seed).with_gradient(self.shot.errors.gradient_degC)
        folder = self.folder(description.scene)
        if not folder.exists():
            write_scene(world, folder, self.shot)
        options = self.options if self.options.fillers is not None else replace(self.options, fillers=[])
        return outline_scene(folder, description, options, LAYOUTS["rgbt_scenes"])  # every pixel was measured

    def folder(self, name: str) -> Path:
        """Return the folder of a scene; its name has the parameters, a hash of the errors and one of the generator."""
        source = b"".join(p.read_bytes() for p in sorted(Path(__file__).parent.glob("*.py")))
        version = hashlib.sha256(source).hexdigest()[:8]
        shot = self.shot
        counts = f"{shot.width}x{shot.height}-{shot.views}v-{shot.points}p-seed{shot.seed}"
        stated = json.dumps(asdict(shot.errors), sort_keys=True)
        errors = "" if shot.errors == CaptureErrors() else f"-errors{hashlib.sha256(stated.encode()).hexdigest()[:8]}"
        return self.root / "synthetic" / f"{name}-{counts}{errors}-{version}"
