"""Find the scenes among the files of an archive or of a published folder."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import PurePosixPath

from tdgbench.data.get.errors import BadFileError
from tdgbench.data.get.sources import Source
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.names import check_scene_name

# What the top of a scene holds, in the layouts of the authors' loaders (docs/data.md).
_FOLDERS = re.compile("sparse|colmap|colmap_sparse|rgb|thermal|warped_thermal|raw_images|images(_[0-9]+)?")
_FILES = re.compile("transforms(_thermal)?[.]json|temperature_bounds[.]json")


def scene_folders(paths: Iterable[PurePosixPath]) -> list[PurePosixPath]:
    """The topmost folders that hold what a scene holds, in the order of their first files.

    >>> scene_folders([PurePosixPath("ThermalMix/lion/rgb/1.jpg"), PurePosixPath("ThermalMix/README.md")])
    [PurePosixPath('ThermalMix/lion')]
    """
    found = {root: None for path in paths if (root := _top(path)) is not None}
    return [root for root in found if not any(above in found for above in root.parents)]


def by_scene(source: Source, paths: Iterable[PurePosixPath], default: str, where: str) -> dict[str, PurePosixPath]:
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


def scene_of_archive(source: Source, stem: str) -> str | None:
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
