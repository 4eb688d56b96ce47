"""The 14 scenes of the paper's Table 1: data set, group, label and accepted folder names."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_folder, is_hidden, is_there, listed

GROUPS = {
    "day": "Day light conditions",
    "dark": "Dark light conditions",
    "360": "360-degree scenes",
    "forward": "Forward-facing scenes",
}
DATASETS = {"rgbt_scenes": "RGBT-Scenes", "thermalmix": "ThermalMix"}
FLIR_E6_PRO = (  # of the ten scenes of RGBT-Scenes; what its extension (GlassCup, DarkScenes) was taken with is unknown
    "240×180 px (FLIR E6 PRO); shown images as shipped are enlarged to 640×480 px by FLIR Thermal Studio, say their "
    "authors (github.com/chen-hangyu/Thermal-Gaussian-main, issue 5)"
)
SENSORS = dict.fromkeys(("Dimsum", "DailyStuff", "Ebike", "RoadBlock", "Truck", "RotaryKiln", "Parterre"), FLIR_E6_PRO)


@dataclass(frozen=True)
class RegisteredScene:
    """One scene of Table 1."""

    name: str
    dataset: str  # a key of DATASETS
    group: str  # a key of GROUPS
    label: str  # as the paper prints it
    aliases: tuple[str, ...] = ()

    def matches(self, folder: str) -> bool:
        """Return whether a folder name is the name or an alias, ignoring case, spaces and punctuation."""
        return plain_name(folder) in {plain_name(name) for name in (self.name, *self.aliases)}

    def find(self, dataset_folder: Path) -> Path | None:
        """Find this scene's folder in its data set's, or None. Raises SceneError if there are two."""
        if not is_folder(dataset_folder):
            return None
        folders = [p for p in listed(dataset_folder) if not is_hidden(p.name) and self.matches(p.name) and is_folder(p)]
        if len(folders) > 1:
            raise SceneError(f"{' and '.join(map(str, folders))} are both the scene {self.name}; keep one of them")
        return folders[0] if folders else None


def dataset_folder(root: Path, dataset: str) -> Path:
    """Return the folder of a data set, a key of DATASETS, in a data root: its title, in any case and punctuation."""
    folder = root / DATASETS[dataset]
    if is_folder(folder) or not is_folder(root):
        return folder
    wanted = plain_name(folder.name)
    return next((path for path in listed(root) if plain_name(path.name) == wanted and is_folder(path)), folder)


def plain_name(name: str) -> str:
    """Return a name without case, spaces and punctuation."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


SCENES = tuple(
    RegisteredScene(name, dataset, group, label, aliases)
    for name, dataset, group, label, aliases in [
        ("Dimsum", "rgbt_scenes", "day", "Dimsum", ()),
        ("DailyStuff", "rgbt_scenes", "day", "DailyStuff", ("DailyStuffs",)),
        ("Ebike", "rgbt_scenes", "day", "Ebike", ("E-Bikes", "Ebikes")),
        ("RoadBlock", "rgbt_scenes", "day", "Road Block", ("RoadBlocks",)),
        ("Truck", "rgbt_scenes", "day", "Truck", ()),
        ("RotaryKiln", "rgbt_scenes", "day", "Rotary Kiln", ()),
        ("Parterre", "rgbt_scenes", "day", "Parterre", ()),
        ("GlassCup", "rgbt_scenes", "day", "Glass Cup", ("GlassCups",)),
        ("DarkScenes", "rgbt_scenes", "dark", "Dark Scenes", ("DarkScene", "Dark")),
        ("Laptop", "thermalmix", "360", "Laptop", ()),
        ("Pan", "thermalmix", "360", "Pan", ()),
        ("Lion", "thermalmix", "360", "Lion", ()),
        ("Hand", "thermalmix", "forward", "Hand", ("Hands",)),
        ("Face", "thermalmix", "forward", "Face", ("Faces",)),
    ]
)
LABELS = {scene.name: scene.label for scene in SCENES}


BUILT_IN, BUILT_IN_DEGC = "synthetic", "synthetic_degC"  # titles of the generated scenes' data sets
DRIFTING = "_drifting"  # ends the title of a data set with the errors of a thermal camera added


BUILT_IN_FILE = "built_in.txt"  # lies in the folder of a built-in scene, which stays one when it is read as a capture
ORIGIN = "origin"  # key of `Scene.assumed`, which scenes with that file have


def origin_of(folder: Path) -> dict[str, str]:
    """Return that a folder holds a built-in scene, for `Scene.assumed`; empty of captures."""
    return {ORIGIN: "a scene that is built into tdgbench, no capture"} if is_there(folder / BUILT_IN_FILE) else {}


def is_built_in(dataset: str) -> bool:
    """Return whether a data set, by its title, holds tdgbench's generated scenes.

    >>> is_built_in("synthetic"), is_built_in("synthetic_degC_drifting"), is_built_in("synthetic_hall")
    (True, True, False)
    """
    return dataset.removesuffix(DRIFTING) in (BUILT_IN, BUILT_IN_DEGC)


def sensor_of(dataset: str, scene: str) -> dict[str, str]:
    """Return what is known of the sensor that took a scene's thermal images, for `Scene.assumed`; empty if nothing is.

    dataset: its title. scene: its name.

    >>> sensor_of("RGBT-Scenes", "Truck")["sensor"][:24], sensor_of("mine", "Truck")
    ('240×180 px (FLIR E6 PRO)', {})
    """
    known = dataset == DATASETS["rgbt_scenes"] and scene in SENSORS
    return {"sensor": SENSORS[scene]} if known else {}


def registered(name: str) -> RegisteredScene:
    """Find a scene by name or alias. Raises SceneError with all names.

    >>> registered("road_block").label, registered("Hands").name
    ('Road Block', 'Hand')
    """
    for scene in SCENES:
        if scene.matches(name):
            return scene
    raise SceneError(f"{name!r} is not one of the paper's scenes: {', '.join(s.name for s in SCENES)}")
