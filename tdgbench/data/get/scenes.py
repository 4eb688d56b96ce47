"""Scenes among published files, and in a folder with `.download.json`, by which a second run fetches nothing."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from tdgbench.data.get.sources import BadFileError, GetError, PublishedDataset
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import check_scene_name, is_folder, is_hidden, is_there, listed, read_bytes

FILE = ".download.json"

# What the top of a scene holds, in the layouts of the authors' loaders (docs/data.md).
_FOLDERS = re.compile("sparse|colmap|colmap_sparse|rgb|thermal|warped_thermal|raw_images|images(_[0-9]+)?")
_FILES = re.compile("transforms(_thermal)?[.]json|temperature_bounds[.]json")


@dataclass(frozen=True)
class SceneRecord:
    """What a scene was made of.

    page: where it is published. downloads: identity of each published file, by path. scenes: all that these files hold.
    """

    page: str
    downloads: dict[str, str]
    scenes: list[str]

    def write(self, scene: Path) -> None:
        """Write the record into a scene's folder, which is not in its place yet."""
        text = json.dumps(asdict(self), indent=1, ensure_ascii=False)
        (scene / FILE).write_text(text + "\n", encoding="utf-8")


class FoundScene(NamedTuple):
    """A scene that is there; its record is None if it was not fetched by this program."""

    folder: Path
    record: SceneRecord | None

    def is_made_of(self, identities: dict[str, str]) -> bool:
        """Whether it was made of published files, in the versions that are published. identities: by path."""
        return self.record is not None and identities.items() <= self.record.downloads.items()


def read_record(scene: Path) -> SceneRecord | None:
    """The record of a scene; None for a scene that was not downloaded by this program. Raises SceneError."""
    path = scene / FILE
    if not is_there(path):
        return None
    try:
        return TypeAdapter(SceneRecord).validate_json(read_bytes(path))
    except ValidationError as error:
        raise SceneError(
            f"{path} is damaged; remove it: the scene counts as not fetched by this command then"
        ) from error


def found_scenes(source: PublishedDataset, folder: Path) -> dict[str, FoundScene]:
    """Scenes in the folder of a data set by name. Raises SceneError if two folders are the same scene."""
    found: dict[str, FoundScene] = {}
    for path in listed(folder) if is_folder(folder) else []:
        if is_hidden(path.name) or not is_folder(path):
            continue
        scene = source.scene(path.name)
        if scene in found:
            raise GetError(f"{found[scene].folder} and {path} are both the scene {scene}; keep one of them")
        found[scene] = FoundScene(path, read_record(path))
    return found


def scene_folders(paths: Iterable[PurePosixPath]) -> list[PurePosixPath]:
    """The topmost folders that hold what a scene holds, in the order of their first files.

    >>> scene_folders([PurePosixPath("ThermalMix/lion/rgb/1.jpg"), PurePosixPath("ThermalMix/README.md")])
    [PurePosixPath('ThermalMix/lion')]
    """
    found = {root: None for path in paths if (root := _top(path)) is not None}
    return [root for root in found if not any(above in found for above in root.parents)]


def by_scene(
    source: PublishedDataset, paths: Iterable[PurePosixPath], default: str, where: str
) -> dict[str, PurePosixPath]:
    """Scenes among some files: the name of each, and its folder.

    default: name of a scene that lies at the top, without a folder. where: for messages. Raises BadFileError if two
    have one name, or one has a name that results cannot have.
    """
    scenes: dict[str, PurePosixPath] = {}
    for root in scene_folders(paths):
        name = source.scene(root.name or default)
        try:
            check_scene_name(name)
        except SceneError as error:
            raise BadFileError(f"{where}: {error}") from error
        if name in scenes:
            raise BadFileError(f"{where} holds two scenes {name}: {scenes[name]} and {root}; unpack it by hand")
        scenes[name] = root
    return scenes


def scene_of_archive(source: PublishedDataset, stem: str) -> str | None:
    """The one scene that an archive is named after; None for an archive of the whole data set.

    >>> from tdgbench.data.get.sources import SOURCES
    >>> [scene_of_archive(SOURCES["thermalmix"], stem) for stem in ("lion", "panel", "ThermalMix_v2")]
    ['Lion', 'panel', None]
    """
    plain = re.sub("[^a-z0-9]", "", stem.lower())
    return None if plain.startswith(re.sub("[^a-z0-9]", "", source.folder.lower())) else source.scene(stem)


def _top(path: PurePosixPath) -> PurePosixPath | None:
    """The folder that a file makes a scene: the one above the first part which only scenes have."""
    for number, part in enumerate(path.parts):
        is_last = number == len(path.parts) - 1
        if (_FILES if is_last else _FOLDERS).fullmatch(part.lower()):
            return PurePosixPath(*path.parts[:number])
    return None
