"""What is downloaded together: an archive, or the single files of a scene; and whether it is there already."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from tdgbench.data.get.archives.checking import is_junk
from tdgbench.data.get.archives.reading import UNREADABLE, is_archive, stem
from tdgbench.data.get.errors import GetError
from tdgbench.data.get.record import SceneRecord, read_record
from tdgbench.data.get.remote import RemoteFile
from tdgbench.data.get.scenes import by_scene, scene_of_archive
from tdgbench.data.get.sources import Source
from tdgbench.scenes.inputs import is_folder, listed
from tdgbench.scenes.names import is_hidden


@dataclass(frozen=True)
class Package:
    """Published files that become scenes together.

    name: for messages. root: folder of the scene among published files; None: `files` is one archive. scene: None if
    only the content of the archive tells.
    """

    name: str
    files: tuple[RemoteFile, ...]
    scene: str | None
    root: PurePosixPath | None = None

    @property
    def size(self) -> int | None:
        """Bytes to download; None if they are not published."""
        sizes = [file.size for file in self.files]
        return None if None in sizes else sum(size or 0 for size in sizes)

    @property
    def identities(self) -> dict[str, str]:
        return {str(file.path): file.identity for file in self.files}


@dataclass(frozen=True)
class Listing:
    """The packages of a data set, and the paths of published files that are not fetched."""

    packages: tuple[Package, ...]
    unreadable: tuple[PurePosixPath, ...]  # archives of kinds that cannot be unpacked here
    others: tuple[PurePosixPath, ...]  # no part of a scene


class Found(NamedTuple):
    """A scene that is there; its record is None if it was not fetched by this program."""

    folder: Path
    record: SceneRecord | None

    def is_of(self, package: Package) -> bool:
        """Whether it was made of a package, in the version that is published."""
        return self.record is not None and package.identities.items() <= self.record.downloads.items()


class State(Enum):
    """Whether a package is there."""

    MISSING = "to be fetched"
    THERE = "there"
    FOREIGN = "there, but not fetched by this command"
    OTHER = "there, but another version"


def sort_out(source: Source, files: Iterable[RemoteFile]) -> Listing:
    """Group published files. Files inside the folder of a scene belong to it, archives too. Raises GetError."""
    files = [file for file in files if not is_junk(file.path)]
    scenes = by_scene(source, [file.path for file in files], source.folder, f"the published folder {source.folder}")
    packages: list[Package] = []
    unreadable: list[PurePosixPath] = []
    others: list[PurePosixPath] = []
    for name, root in scenes.items():
        inside = tuple(file for file in files if root in file.path.parents)
        packages.append(Package(str(root) if root.parts else name, inside, name, root))
    taken = {file.path for package in packages for file in package.files}
    for file in (file for file in files if file.path not in taken):
        if is_archive(file.path.name):
            packages.append(Package(str(file.path), (file,), scene_of_archive(source, stem(file.path.name))))
        else:
            (unreadable if file.path.name.lower().endswith(UNREADABLE) else others).append(file.path)
    return Listing(tuple(packages), tuple(unreadable), tuple(others))


def chosen(source: Source, packages: Iterable[Package], scenes: Iterable[str]) -> list[Package]:
    """Packages of some scenes; all if none is named. Raises GetError for a scene that no package is of."""
    packages = list(packages)
    names = [source.scene(scene) for scene in scenes]
    there = {package.scene.lower() for package in packages if package.scene}
    unknown = [name for name in names if name.lower() not in there]
    if unknown:
        shown = ", ".join(package.name for package in packages)
        raise GetError(
            f"no file of {source.folder} is of the scene {unknown[0]} alone; published are {shown}: choose among the "
            "scenes that are single files, or leave --scene out"
        )
    wanted = {name.lower() for name in names}
    return [package for package in packages if not wanted or (package.scene or "").lower() in wanted]


def found_scenes(source: Source, folder: Path) -> dict[str, Found]:
    """Scenes in the folder of a data set by name. Raises SceneError if two folders are the same scene."""
    found: dict[str, Found] = {}
    for path in listed(folder) if is_folder(folder) else []:
        if is_hidden(path.name) or not is_folder(path):
            continue
        scene = source.scene(path.name)
        if scene in found:
            raise GetError(f"{found[scene].folder} and {path} are both the scene {scene}; keep one of them")
        found[scene] = Found(path, read_record(path))
    return found


def state(package: Package, there: Mapping[str, Found]) -> State:
    """Whether a package is among the scenes that are there."""
    made = [one.record for one in there.values() if one.is_of(package) and one.record]
    if made:
        return State.THERE if all(scene in there for scene in made[0].scenes) else State.MISSING
    if package.scene is None or package.scene not in there:
        return State.MISSING
    return State.FOREIGN if there[package.scene].record is None else State.OTHER
