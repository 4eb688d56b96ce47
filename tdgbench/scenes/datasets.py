"""Data sets as plug-ins: each loads scenes by name and lists the missing ones."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Protocol, runtime_checkable

from pydantic import AfterValidator

from tdgbench.scenes import registry
from tdgbench.scenes.errors import MissingScenesError, SceneError
from tdgbench.scenes.geometry import judged
from tdgbench.scenes.inputs import check_scene_name, is_folder, is_hidden, is_there, listed, utf8_name
from tdgbench.scenes.layouts import LAYOUTS, detect
from tdgbench.scenes.options import Description, FolderPath, ReadOptions
from tdgbench.scenes.read import Outline, outline_scene
from tdgbench.scenes.scene import Scene


def _one_of(names: Iterable[str]) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"must be one of {', '.join(names)}")
        return name

    return AfterValidator(check)


LayoutName = Annotated[str, _one_of(LAYOUTS)]
PaperDataset = Annotated[str, _one_of(registry.DATASETS)]


class Dataset(Protocol):
    """Source of scenes. A name of None means the only scene, where there is one."""

    def names(self) -> list[str]:
        """Return names of all scenes."""

    def missing(self, names: list[str]) -> list[str]:
        """Return the given names whose scenes are not on disk."""

    def explain_missing(self, names: list[str]) -> str:
        """Return one message for all missing scenes: names, expected folders, publisher."""

    def describe(self, name: str | None) -> Description:
        """Describe a scene without reading it. Raises SceneError for an unknown name."""

    def load(self, name: str | None) -> Scene:
        """Read a scene. Raises MissingScenesError or SceneError."""


@runtime_checkable
class Outlines(Dataset, Protocol):
    """A data set that can tell a scene without decoding its images, so that a finished cell is checked faster.

    It may be a base class, which gives `missing` and `load`.
    """

    def missing(self, names: list[str]) -> list[str]:
        there = self.names()
        return [name for name in names if name not in there]

    def outline(self, name: str | None) -> Outline:
        """Return the scene that `load` reads. Raises MissingScenesError or SceneError."""
        raise NotImplementedError

    def load(self, name: str | None) -> Scene:
        return self.outline(name).read()


def outline_of(dataset: Dataset, name: str | None) -> Outline:
    """Return the outline of a scene, else the scene itself. Raises MissingScenesError or SceneError."""
    if isinstance(dataset, Outlines):
        return dataset.outline(name)
    scene = judged(dataset.load(name))
    return Outline(scene, lambda: scene)


class RegisteredDataset(Outlines):
    """The paper's scenes of one data set, a key of `registry.DATASETS`, or of all (None).

    Folders: <root>/RGBT-Scenes/<Scene>, <root>/ThermalMix/<Scene>.

    >>> dataset = RegisteredDataset("data", ReadOptions(), "thermalmix")
    >>> dataset.names()
    ['Laptop', 'Pan', 'Lion', 'Hand', 'Face']
    >>> dataset.describe("lion")
    Description(scene='Lion', dataset='ThermalMix', group='360')
    """

    def __init__(self, root: FolderPath, options: ReadOptions, dataset: PaperDataset | None = None) -> None:
        self.root = Path(root)
        self.options = options
        self.dataset = dataset

    def names(self) -> list[str]:
        return [s.name for s in registry.SCENES if self.dataset in (None, s.dataset)]

    def missing(self, names: list[str]) -> list[str]:
        return [name for name in names if not self._is_there(name)]

    def describe(self, name: str | None) -> Description:
        if name is None:
            raise SceneError(f"choose a scene with scene=…: {', '.join(self.names())}")
        scene = self._registered(check_scene_name(name))
        return Description(scene.name, registry.DATASETS[scene.dataset], scene.group)

    def outline(self, name: str | None) -> Outline:
        description = self.describe(name)
        folder = self._find(description.scene)
        if folder is None:
            raise MissingScenesError([description.scene], self.explain_missing([description.scene]))
        if detect(folder) is LAYOUTS["sear"]:
            what = "whose cameras and images are others: read it with dataset=sear"
            raise SceneError(f"{folder} is of SEAR's compilation, and no scene of {description.dataset}, {what}")
        return outline_scene(folder, description, self.options, None)

    def explain_missing(self, names: list[str]) -> str:
        lines = [f"{len(names)} {'scene is' if len(names) == 1 else 'scenes are'} not in {self.root}:"]
        for key in dict.fromkeys(self._registered(name).dataset for name in names):
            missing = [name for name in names if self._registered(name).dataset == key]
            lines.append(f"  {self.root / registry.DATASETS[key]}/: {', '.join(missing)}")
            lines.append(f"    tdgbench data get {key} {shlex.quote(str(self.root))}")
            lines.append(f"    layout: <scene>/ with {LAYOUTS[key].looks}")
        nowhere = "" if is_there(self.root) else f"{self.root} does not exist; "
        lines.append(f"  {nowhere}elsewhere: data.root=DIR; other layouts: docs/data.md")
        return "\n".join(lines)

    def _registered(self, name: str) -> registry.RegisteredScene:
        scene = registry.registered(name)
        if self.dataset not in (None, scene.dataset):
            raise SceneError(
                f"{scene.name} is a scene of {registry.DATASETS[scene.dataset]}: use dataset={scene.dataset}"
            )
        return scene

    def _is_there(self, name: str) -> bool:
        """Return whether a scene can be loaded, or loading says why not."""
        try:
            return self._find(name) is not None
        except SceneError:
            return True

    def _find(self, name: str) -> Path | None:
        scene = self._registered(name)
        return scene.find(registry.dataset_folder(self.root, scene.dataset))


class FolderDataset(Outlines):
    """Any captures in one of the layouts: `root` is the scene, or holds one folder per scene.

    layout: a key of LAYOUTS, of the data set of that name, whose scenes may also be in <root>/<title>, for example
    <root>/ThermoScenes; None detects the layout of each scene.
    """

    def __init__(self, root: FolderPath, options: ReadOptions, layout: LayoutName | None = None) -> None:
        self.layout = None if layout is None else LAYOUTS[layout]
        self.root = Path(root)
        self.options = options

    def names(self) -> list[str]:
        root = self._root()
        if self._is_scene(root):
            return [name for name in [root.resolve().name] if not is_hidden(name)]
        if not is_folder(root):
            return []
        return [p.name for p in listed(root) if not is_hidden(p.name) and self._can_be_scene(p)]

    def explain_missing(self, names: list[str]) -> str:
        root, there = self._root(), ", ".join(self.names())
        if not is_there(root):
            return f"{root} does not exist; set data.root=DIR"
        if there and not any(is_folder(root / name) for name in names):
            return f"{', '.join(names)} not found in {root}; scenes there: {there}"
        empty = next((root / name for name in names if is_folder(root / name)), root)
        layouts = f"`tdgbench data check {shlex.quote(str(empty))}` lists the layouts"
        hint = layouts if self.layout is None else f"a scene is a folder with {self.layout.looks}"
        if not there:
            return f"no scene in {root}; set data.root=DIR, where no name begins with a dot; {hint}"
        return f"{', '.join(names)} not found in {root} (scenes there: {there}); {hint}"

    def describe(self, name: str | None) -> Description:
        root = self._root()
        if self._is_scene(root):
            check_scene_name(root.resolve().name)
        names = self.names()
        if name is None and len(names) > 1:
            raise SceneError(f"{root} holds {len(names)} scenes: {', '.join(names)}; name one of them: scene=…")
        if name is None and not names:
            wanted = ["a scene (scene=…)"]
            raise MissingScenesError(wanted, self.explain_missing(wanted))
        title = "folder" if self.layout is None else self.layout.title
        return Description(check_scene_name(names[0] if name is None else name), title, "")

    def outline(self, name: str | None) -> Outline:
        description, root = self.describe(name), self._root()
        if description.scene not in self.names():
            self._is_scene(root / description.scene)  # its error says more, where there is one
            raise MissingScenesError([description.scene], self.explain_missing([description.scene]))
        folder = root if self._is_scene(root) else root / description.scene
        return outline_scene(folder, description, self.options, self.layout)

    def _root(self) -> Path:
        if self.layout is not None and is_folder(utf8_name(self.root) / self.layout.title):
            return self.root / self.layout.title
        return utf8_name(self.root)

    def _is_scene(self, folder: Path) -> bool:
        return detect(folder) is not None if self.layout is None else self.layout.fits(folder)

    def _can_be_scene(self, folder: Path) -> bool:
        """Return whether a folder is a scene. One that may not be read is none, so that the others are found."""
        try:
            return self._is_scene(folder)
        except SceneError:
            return False
