"""Fetch a data set: list, compare with what is there, download, unpack; each scene is put in place whole."""

from __future__ import annotations

import glob
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from pydantic import BaseModel, ValidationError

from tdgbench.bench.lock import file_lock
from tdgbench.data.get.archives import stem, unpack
from tdgbench.data.get.listing import ZENODO, Package, by_scene, download, list_files, packages_of
from tdgbench.data.get.sources import BadFileError, GetError, PublishedDataset
from tdgbench.data.progress import step
from tdgbench.files import whole_folder
from tdgbench.scenes.inputs import is_folder, is_hidden, is_there, listed, read_bytes
from tdgbench.terminal import say
from tdgbench.text import one_line

RECORD = ".download.json"  # in the folder of a scene
DOWNLOADS = ".get"  # folder of downloads in the folder of the data set; hidden, so that it is no scene
MISSING, THERE, LEFT = "to be fetched", "there", "there, but not fetched by this command, or in another version"


class SceneRecord(BaseModel):
    """What a scene was made of, by which a second run fetches nothing.

    downloads: identity of each published file, by path. scenes: names of all that these files hold.
    """

    downloads: dict[str, str]
    scenes: list[str]


@dataclass(frozen=True)
class Download:
    """The download of one data set into `folder`.

    scenes: names; empty: all. force: fetch and replace what is there. zenodo: address of Zenodo.
    """

    source: PublishedDataset
    folder: Path
    scenes: tuple[str, ...] = ()
    force: bool = False
    zenodo: str = ZENODO

    @property
    def downloads(self) -> Path:
        return self.folder / DOWNLOADS

    def listing(self) -> tuple[list[Package], list[PurePosixPath]]:
        """List the published packages of the chosen scenes, and the files that are not fetched. Raises GetError."""
        return packages_of(self.source, list_files(self.source, self.zenodo), self.scenes)

    def state(self, package: Package, there: Mapping[str, Path]) -> str:
        """Return whether a package is MISSING, THERE or LEFT. there: folders of scenes by name."""
        made = made_of(package, there)
        if self.force or (made and not all(scene in there for scene in next(iter(made.values())).scenes)):
            return MISSING
        return THERE if made else LEFT if package.scene in there else MISSING


def made_of(package: Package, there: Mapping[str, Path]) -> dict[str, SceneRecord]:
    """Return the records of the scenes that were made of a package's files, as published, by name."""
    records = ((name, read_record(folder)) for name, folder in there.items())
    return {name: r for name, r in records if r is not None and package.identities.items() <= r.downloads.items()}


def read_record(scene: Path) -> SceneRecord | None:
    """Read the record of a scene; None for a damaged one, and for a scene that this program did not download."""
    path = scene / RECORD
    try:
        return SceneRecord.model_validate_json(read_bytes(path)) if is_there(path) else None
    except ValidationError:
        return None


def scene_folders(source: PublishedDataset, folder: Path) -> dict[str, Path]:
    """Return the folders of scenes in that of a data set, by name. Raises GetError if two are the same scene."""
    scenes: dict[str, Path] = {}
    for path in listed(folder) if is_folder(folder) else []:
        if is_folder(path) and not is_hidden(path.name):
            other = scenes.setdefault(source.scene(path.name), path)
            if other != path:
                raise GetError(f"{other} and {path} are both the scene {source.scene(path.name)}; keep one of them")
    return scenes


def fetch(request: Download) -> bool:
    """Fetch a data set and say what was done; return whether all that is published is there at the end.

    Raises GetError and OSError for what stops the whole download; a file that cannot be used does not. What was
    downloaded is kept then, and the same call goes on from it.
    """
    request.folder.mkdir(parents=True, exist_ok=True)
    with file_lock(request.downloads / ".lock") as acquired:
        if not acquired:
            raise GetError(f"another process is fetching into {request.folder}; wait for its end")
        packages, others = request.listing()
        there = scene_folders(request.source, request.folder)
        if others:
            names = ", ".join(map(str, others))
            say(one_line(f"not fetched: {names} ({request.source.page}; scenes belong into {request.folder})"))
        fetched, already, problems = 0, 0, 0
        for package in packages:
            state = request.state(package, there)
            if state == THERE:
                already += len(made_of(package, there))
            elif state == LEFT and package.scene:
                _say_left(there[package.scene])
            else:
                try:
                    fetched += _fetch_package(request, package)
                except BadFileError as error:
                    say(one_line(str(error)), "problem:", stderr=True)
                    problems += 1
    end = _count(problems, "problem") if problems else f"{_count(already, 'scene')} already there"
    say(one_line(f"{request.folder}: {_count(fetched, 'scene')} fetched, {end}"))
    return not problems


def _fetch_package(request: Download, package: Package) -> int:
    """Download a package and put its scenes into their places; return their number.

    Scenes of other origin are left as they are, and so are the downloads then. Raises BadFileError if an archive is
    refused or damaged: nothing of it is in place then. Raises OSError.
    """
    if request.force:
        _remove(request, package)
    with step(package.name, package.size if package.is_archive else len(package.files), package.is_archive) as report:
        for number, file in enumerate(package.files, 1):
            download(file, request.downloads / file.path, report if package.is_archive else lambda _: None)
            if not package.is_archive:
                report(number)
    unpacked = request.downloads / ".unpacked"
    shutil.rmtree(unpacked, ignore_errors=True)
    try:
        placed, left = _put_in_place(request, package, unpacked)
    finally:
        shutil.rmtree(unpacked, ignore_errors=True)
    for folder in left:
        _say_left(folder)
    if not left:
        _remove(request, package)
    return placed


def _put_in_place(request: Download, package: Package, unpacked: Path) -> tuple[int, list[Path]]:
    """Unpack a package; put the scenes that are not there yet, or all with `force`, into their places.

    Returns their number, and the folders of scenes of other origin, which are left as they are.
    """
    there = scene_folders(request.source, request.folder)
    paths = [file.path for file in package.files]
    if package.is_archive:
        paths = unpack(request.downloads / paths[0], unpacked)
    else:
        for path in paths:
            (unpacked / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(request.downloads / path, unpacked / path)  # permissions by umask; gdown's are not
    scenes = by_scene(request.source, paths, stem(PurePosixPath(package.name).name) or package.name, package.name)
    if not scenes:
        raise BadFileError(f"{package.name} holds no scene: no folder with sparse/, rgb/, thermal/ or transforms.json")
    left, placed, made = [], 0, made_of(package, there)
    for name, root in scenes.items():
        if name in there and not request.force:
            left += [] if name in made else [there[name]]
            continue
        folder = there.get(name, request.folder / name)
        with whole_folder(folder) as part:
            for content in (unpacked / root).iterdir():
                content.replace(part / content.name)
            record = SceneRecord(downloads=package.identities, scenes=list(scenes))
            (part / RECORD).write_text(record.model_dump_json(indent=1) + "\n", encoding="utf-8")
        files = _count(sum(root in path.parents for path in paths), "file")
        say(one_line(f"{folder}: {files} of {package.name}"))
        placed += 1
    return placed, left


def _remove(request: Download, package: Package) -> None:
    """Remove what was downloaded of a package, with what gdown keeps of unfinished downloads."""
    for target in (request.downloads / file.path for file in package.files):
        for path in (target, *target.parent.glob(f"{glob.escape(target.name)}????????.part")):
            path.unlink(missing_ok=True)


def _say_left(folder: Path) -> None:
    say(one_line(f"{folder} is left as it is: this command did not fetch it, or another version; see --force"))


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
