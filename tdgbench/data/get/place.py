"""Put downloaded scenes into their places: each one whole, with its record, or not at all."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple

from tdgbench.data.get.archives.checking import File, checked_files, size
from tdgbench.data.get.archives.reading import Archive, opened, readable, stem
from tdgbench.data.get.errors import BadFileError, GetError
from tdgbench.data.get.packages import Found, Package
from tdgbench.data.get.progress import amount, meter
from tdgbench.data.get.record import Content, SceneRecord
from tdgbench.data.get.scenes import by_scene
from tdgbench.data.get.sources import Source
from tdgbench.files import whole_folder

CHUNK = 2**20  # bytes
RESERVE = 2**26  # bytes of a disk that are left free


@dataclass(frozen=True)
class Place:
    """The folder of a data set and the scenes in it, which are replaced only with `force`."""

    source: Source
    folder: Path
    there: Mapping[str, Found]
    force: bool

    def target(self, scene: str) -> Path:
        """Folder of a scene: the one that it has, under whatever spelling."""
        return self.there[scene].folder if scene in self.there else self.folder / scene

    def is_free(self, scene: str) -> bool:
        """Whether a scene may be put into its place."""
        return self.force or scene not in self.there


class Placed(NamedTuple):
    """Number of files of each scene that was put into its place; scenes of other origin that were left as they are."""

    files: dict[str, int]
    left: list[str]


def check_space(folder: Path, needed: int, what: str) -> None:
    """Raise GetError unless the disk of a folder has space."""
    free = shutil.disk_usage(folder).free - RESERVE
    if needed > free:
        raise GetError(
            f"the disk of {folder} is too full for {what}: it needs {amount(needed)}, {amount(max(free, 0))} are free; "
            "free some space and run the same command again"
        )


def place_archive(place: Place, package: Package, archive: Path) -> Placed:
    """Unpack the scenes of an archive that are not there yet.

    Raises BadFileError if the archive is refused or damaged; only whole scenes are in place then. Raises OSError.
    """
    with opened(archive) as content:
        files = checked_files(content, archive)
        scenes = by_scene(place.source, [file.path for file in files], stem(archive.name), str(archive))
        if not scenes:
            raise BadFileError(f"{archive} holds no scene: no folder with sparse/, rgb/, thermal/ or transforms.json")
        inside = {
            name: [file for file in files if root in file.path.parents]
            for name, root in scenes.items()
            if place.is_free(name)
        }
        total = sum(map(size, inside.values()))
        check_space(place.folder, total, f"what {archive.name} unpacks to")
        with meter(f"{archive.name}: unpacking", total) as show:
            for name, members in inside.items():
                with whole_folder(place.target(name)) as part:
                    contents = {}
                    for file in members:
                        path = file.path.relative_to(scenes[name])
                        contents[str(path)] = _unpacked(content, archive, file, part.joinpath(path), show.add)
                    SceneRecord(place.source.page, package.identities, list(scenes), contents).write(part)
    left = [name for name in scenes if not place.is_free(name) and not place.there[name].is_of(package)]
    return Placed({name: len(members) for name, members in inside.items()}, left)


def place_files(place: Place, package: Package, downloaded: Mapping[PurePosixPath, Path]) -> Placed:
    """Copy the single files of a scene into its place.

    downloaded: each file on disk by its published path. Raises OSError.
    """
    assert package.scene is not None and package.root is not None
    with whole_folder(place.target(package.scene)) as part:
        contents = {}
        for path, file in downloaded.items():
            inside = path.relative_to(package.root)
            with file.open("rb") as source:
                contents[str(inside)] = _written(source, part.joinpath(inside), file.stat().st_size, lambda _: None)
        SceneRecord(place.source.page, package.identities, [package.scene], contents).write(part)
    return Placed({package.scene: len(contents)}, [])


def _unpacked(archive: Archive, path: Path, file: File, target: Path, show: Callable[[int], None]) -> Content:
    """Unpack a file to a place where nothing is; its content must have the size that the archive declares."""
    with readable(path), archive.content(file.member) as source:
        content = _written(source, target, file.member.size, show)
    if content.size != file.member.size:
        raise BadFileError(f"{path} cannot be unpacked: {file.path} has not the {file.member.size} bytes it declares")
    return content


def _written(source: IO[bytes], target: Path, most: int, show: Callable[[int], None]) -> Content:
    """Write a new file, and end after `most` bytes at the latest. `show` is called with the size of each piece."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, count = hashlib.sha256(), 0
    with target.open("xb") as out:
        while count < most and (chunk := source.read(min(CHUNK, most - count))):
            out.write(chunk)
            digest.update(chunk)
            count += len(chunk)
            show(len(chunk))
    return Content(size=count, sha256=digest.hexdigest())
