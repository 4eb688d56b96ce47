"""`tdgbench data get`: fetch the packages of a data set that are not there yet; put each scene in place whole."""

from __future__ import annotations

import argparse
import glob
import shutil
from contextlib import suppress
from pathlib import Path

from pydantic import BaseModel, ValidationError

from tdgbench.data.get.packages import Package, packages_of, scenes_in, unpack
from tdgbench.data.get.sources import SOURCES, ZENODO, BadFileError, GetError, PublishedDataset, download, list_files
from tdgbench.data.progress import amount, step
from tdgbench.files import file_lock, whole_folder
from tdgbench.scenes.inputs import is_folder, is_hidden, is_there, listed, read_bytes
from tdgbench.terminal import say
from tdgbench.text import one_line

RECORD = ".download.json"  # in the folder of a scene
DOWNLOADS = ".get"  # folder of downloads in the folder of the data set; hidden, so that it is no scene
MISSING, THERE = "to be fetched", "there"
LEFT = "left as it is: this command did not fetch it, or another version; see --force"


class SceneRecord(BaseModel):
    """What a scene was made of, by which a second run fetches nothing.

    downloads: identity of each published file, by path. scenes: names of all that these files hold.
    """

    downloads: dict[str, str]
    scenes: list[str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", choices=SOURCES, help="data set")
    parser.add_argument("root", type=Path, metavar="DIR", help="folder of all data sets, as data.root")
    parser.add_argument("--scene", action="append", default=[], metavar="NAME", help="only this scene; may be repeated")
    parser.add_argument("--list", action="store_true", help="show what would be fetched; fetch nothing")
    parser.add_argument("--force", action="store_true", help="fetch again, and replace scenes that are there")
    parser.add_argument("--zenodo", default=ZENODO, metavar="URL", help="a mirror of Zenodo (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Fetch or list a data set; return the exit status: 1 if something is damaged or refused.

    Raises GetError, with the address for a browser and the folder, and OSError for what stops the whole download.
    """
    source = SOURCES[arguments.dataset]
    folder = arguments.root / source.folder
    say(f"{source.folder} ({source.paper}): {source.page}")
    if arguments.list:
        say(source.holds)
        say(f"state of the address: {source.known}")
    try:
        files, licence = list_files(source, arguments.zenodo)
        packages, others = packages_of(source, files, arguments.scene)
        if others:
            say(one_line(f"not fetched: {', '.join(map(str, others))}; scenes belong into {folder}"))
        if not arguments.list:
            return 0 if fetch(source, folder, packages, arguments.force) else 1
    except GetError as error:
        raise GetError(
            f"{error}; or open {source.page} in a browser and unpack its scenes to {folder}/<Scene>; if the page is "
            f"gone (last known state: {source.known}), ask its authors ({source.authors})"
        ) from error
    there = scene_folders(source, folder)
    for package in packages:
        scene = f", scene {package.scene}" if package.scene else ""
        count = "" if package.is_archive else f", {len(package.files)} files"
        say(one_line(f"{package.name}{scene}{count}: {amount(package.size)}, {state(package, there, arguments.force)}"))
    if licence:
        say(one_line(f"licence, as the record states: {licence}"))
    say(f"in all {amount(sum(package.size or 0 for package in packages) or None)}")
    return 0


def fetch(source: PublishedDataset, folder: Path, packages: list[Package], force: bool = False) -> bool:
    """Fetch packages into the folder of a data set and say what was done; return whether all could be used.

    force: fetch and replace what is there. Raises GetError and OSError for what stops the whole download. What was
    downloaded is kept then, and the same call goes on from it.
    """
    placed, problems = 0, 0
    with file_lock(folder / DOWNLOADS / ".lock") as acquired:
        if not acquired:
            raise GetError(f"another process is fetching into {folder}; wait for its end")
        for package in packages:
            there = scene_folders(source, folder)
            found = state(package, there, force)
            if found == LEFT and package.scene:
                say(one_line(f"{there[package.scene]} is {LEFT}"))
            elif found == MISSING:
                try:
                    placed += _fetch_package(source, folder, package, force)
                except BadFileError as error:
                    say(one_line(str(error)), "problem:", stderr=True)
                    problems += 1
    scenes = len(scene_folders(source, folder))
    say(one_line(f"{folder}: scenes fetched: {placed}, already there: {scenes - placed}, problems: {problems}"))
    return not problems


def state(package: Package, there: dict[str, Path], force: bool = False) -> str:
    """Return whether a package is MISSING, THERE or LEFT. there: folders of scenes by name."""
    made = _made_of(package, there)
    if force or (made and not all(scene in there for record in made.values() for scene in record.scenes)):
        return MISSING
    return THERE if made else LEFT if package.scene in there else MISSING


def scene_folders(source: PublishedDataset, folder: Path) -> dict[str, Path]:
    """Return the folders of scenes in that of a data set, by name."""
    paths = [path for path in listed(folder) if is_folder(path)] if is_folder(folder) else []
    return {source.scene(path.name): path for path in paths if not is_hidden(path.name)}


def _made_of(package: Package, there: dict[str, Path]) -> dict[str, SceneRecord]:
    """Return the records of the scenes that were made of a package's files, as published, by name."""
    made = {}
    for name, folder in there.items():
        with suppress(ValidationError):  # of a damaged record
            text = read_bytes(folder / RECORD) if is_there(folder / RECORD) else b""
            record = SceneRecord.model_validate_json(text)
            if package.identities.items() <= record.downloads.items():
                made[name] = record
    return made


def _fetch_package(source: PublishedDataset, folder: Path, package: Package, force: bool) -> int:
    """Download a package, put its scenes into their places and remove what was downloaded; return their number.

    If all its scenes are there already, the download stays. Raises BadFileError for an archive that is refused or
    damaged: nothing of it is in place then. Raises OSError.
    """
    targets = [folder / DOWNLOADS / file.path for file in package.files]
    if force:
        _remove(targets)
    with step(package.name, package.size, is_bytes=True) as report:
        done = 0
        for file, target in zip(package.files, targets, strict=True):
            download(file, target, lambda there, before=done: report(before + there))  # type: ignore[misc]
            done += target.stat().st_size
    unpacked = folder / DOWNLOADS / ".unpacked"
    shutil.rmtree(unpacked, ignore_errors=True)
    try:
        placed = _put_in_place(source, folder, package, unpacked, force)
    finally:
        shutil.rmtree(unpacked, ignore_errors=True)
    if placed:
        _remove(targets)
    return placed


def _put_in_place(source: PublishedDataset, folder: Path, package: Package, unpacked: Path, force: bool) -> int:
    """Unpack a package; put the scenes that are not there yet, or all with `force`, into their places."""
    there, paths = scene_folders(source, folder), [file.path for file in package.files]
    if package.is_archive:
        paths = unpack(folder / DOWNLOADS / paths[0], unpacked)
    else:
        for path in paths:
            (unpacked / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / DOWNLOADS / path, unpacked / path)  # permissions by umask; gdown's are not
    scenes, made = scenes_in(source, paths, Path(package.name).stem, package.name), _made_of(package, there)
    if not scenes:
        raise BadFileError(f"{package.name} holds no scene: no folder with sparse/, rgb/, thermal/ or transforms.json")
    record, placed = SceneRecord(downloads=package.identities, scenes=list(scenes)), 0
    for name, root in scenes.items():
        place = there.get(name, folder / name)
        if force or name not in there:
            with whole_folder(place) as part:
                for content in (unpacked / root).iterdir():
                    content.replace(part / content.name)
                (part / RECORD).write_text(record.model_dump_json(indent=1) + "\n", encoding="utf-8")
            say(one_line(f"{place}: {sum(root in path.parents for path in paths)} files of {package.name}"))
            placed += 1
        elif name not in made:
            say(one_line(f"{place} is {LEFT}"))
    return placed


def _remove(targets: list[Path]) -> None:
    """Remove downloads, with what gdown keeps of unfinished ones."""
    for target in targets:
        for path in (target, *target.parent.glob(f"{glob.escape(target.name)}????????.part")):
            path.unlink(missing_ok=True)
