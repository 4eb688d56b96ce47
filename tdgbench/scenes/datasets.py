"""The data sets as plug-ins: each has `load(name)`, `names()`, and says which scenes are missing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tdgbench.scenes import registry
from tdgbench.scenes.layout import LAYOUT, ReadOptions, read_scene
from tdgbench.scenes.scene import MissingScenesError, Scene, SceneError


@dataclass(frozen=True)
class Description:
    """A scene's place in results."""

    scene: str
    dataset: str
    group: str


class Dataset(Protocol):
    """Where scenes come from."""

    def names(self) -> list[str]:
        """The scenes it knows."""

    def missing(self, names: list[str]) -> list[str]:
        """Those of the names that are not there."""

    def explain_missing(self, names: list[str]) -> str:
        """One message for all missing scenes: which, where they are expected, who publishes them."""

    def describe(self, name: str | None) -> Description:
        """What a scene is called in results, without reading it. Raises SceneError for a name it cannot know."""

    def load(self, name: str | None) -> Scene:
        """One scene. Raises MissingScenesError or SceneError."""


class RegisteredDataset:
    """The paper's scenes of one data set (RGBT-Scenes or ThermalMix), or of both (`dataset: null`).

    They lie in <root>/RGBT-Scenes/<Scene> and <root>/ThermalMix/<Scene>.
    """

    def __init__(self, root: str, options: ReadOptions, dataset: str | None = None) -> None:
        self.root = Path(root)
        self.options = options
        self.dataset = dataset

    def names(self) -> list[str]:
        return [s.name for s in registry.SCENES if self.dataset in (None, s.dataset)]

    def missing(self, names: list[str]) -> list[str]:
        return [name for name in names if self._find(name) is None]

    def describe(self, name: str | None) -> Description:
        if name is None:
            raise SceneError(f"choose a scene with scene=…: {', '.join(self.names())}")
        scene = self._registered(name)
        return Description(scene.name, registry.DATASETS[scene.dataset], scene.group)

    def load(self, name: str | None) -> Scene:
        what = self.describe(name)
        folder = self._find(what.scene)
        if folder is None:
            raise MissingScenesError([what.scene], self.explain_missing([what.scene]))
        return read_scene(folder, what.scene, what.dataset, what.group, self.options)

    def explain_missing(self, names: list[str]) -> str:
        """One message for all missing scenes: which, where they are expected, and who publishes them."""
        lines = [f"{len(names)} {'scene is' if len(names) == 1 else 'scenes are'} not in {self.root}:"]
        for key in dict.fromkeys(self._registered(name).dataset for name in names):
            own = [name for name in names if self._registered(name).dataset == key]
            lines.append(f"  {self.root / registry.DATASETS[key]}/: {', '.join(own)}")
            lines.append(f"    get them from {registry.PUBLISHED_AT[key]}")
        lines.append(f"  layout: {LAYOUT}; elsewhere: data.root=DIR")
        return "\n".join(lines)

    def _registered(self, name: str) -> registry.RegisteredScene:
        try:
            scene = registry.registered(name)
        except KeyError as error:
            raise SceneError(error.args[0]) from error
        if self.dataset not in (None, scene.dataset):
            raise SceneError(
                f"{scene.name} is a scene of {registry.DATASETS[scene.dataset]}: use dataset={scene.dataset}"
            )
        return scene

    def _find(self, name: str) -> Path | None:
        scene = self._registered(name)
        return scene.find(self.root / registry.DATASETS[scene.dataset])


class FolderDataset:
    """Any capture in the RGBT-Scenes layout: <root> itself is the scene, or holds scenes as folders."""

    def __init__(self, root: str, options: ReadOptions) -> None:
        self.root = Path(root)
        self.options = options

    def names(self) -> list[str]:
        if (self.root / "thermal").is_dir():
            return [self.root.resolve().name]
        if not self.root.is_dir():
            return []
        return sorted(p.name for p in self.root.iterdir() if (p / "thermal").is_dir())

    def missing(self, names: list[str]) -> list[str]:
        return [name for name in names if name not in self.names()]

    def explain_missing(self, names: list[str]) -> str:
        there = ", ".join(self.names()) or "none"
        return (
            f"{', '.join(names)} not found in {self.root} (scenes there: {there}). Set data.root=DIR to a scene or to "
            f"a folder of scenes; layout: {LAYOUT}"
        )

    def describe(self, name: str | None) -> Description:
        names = self.names()
        if name is None and len(names) != 1:
            wanted = ["a scene (scene=…)"]
            raise MissingScenesError(wanted, self.explain_missing(wanted))
        return Description(names[0] if name is None else name, "folder", "")

    def load(self, name: str | None) -> Scene:
        what = self.describe(name)
        if what.scene not in self.names():
            raise MissingScenesError([what.scene], self.explain_missing([what.scene]))
        folder = self.root if (self.root / "thermal").is_dir() else self.root / what.scene
        return read_scene(folder, what.scene, what.dataset, what.group, self.options)
