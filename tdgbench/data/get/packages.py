"""Which published files become which scenes: zip archives, and the files in the folder of a scene."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from tdgbench.archives import opened_zip, safe_path
from tdgbench.data.get.sources import BadFileError, GetError, PublishedDataset, RemoteFile
from tdgbench.scenes.registry import plain_name
from tdgbench.text import shortened

JUNK = {"__MACOSX", "Thumbs.db", "desktop.ini"}  # what file managers leave in archives
# What the top of a scene holds, in the layouts of the authors' loaders (docs/data.md).
_FOLDERS = re.compile("sparse|colmap|colmap_sparse|rgb|thermal|warped_thermal|raw_images|images(_[0-9]+)?")
_FILES = re.compile("transforms(_thermal)?[.]json|temperature_bounds[.]json")


class Package(NamedTuple):
    """Published files that become scenes together: one archive, or the files in the folder of a scene.

    name: for messages. scene: None if only the content of the archive tells.
    """

    name: str
    files: list[RemoteFile]
    scene: str | None
    is_archive: bool

    @property
    def size(self) -> int | None:
        """Bytes to download; None if they are not published."""
        return sum(file.size for file in self.files) or None

    @property
    def identities(self) -> dict[str, str]:
        return {str(file.path): file.identity for file in self.files}


def packages_of(
    source: PublishedDataset, files: list[RemoteFile], scenes: list[str]
) -> tuple[list[Package], list[PurePosixPath]]:
    """Group published files; return their packages, and the paths of files that belong to none.

    Files inside the folder of a scene belong to it, archives too. scenes: names; empty: all. Raises GetError for a
    scene that no package is of, and if there is no package.
    """
    files = [file for file in files if not _is_junk(file.path)]
    roots = scenes_in(source, [file.path for file in files], source.folder, source.page)
    inside: dict[str, list[RemoteFile]] = {name: [] for name in roots}
    archives, others = [], []
    for file in files:
        path, stem = file.path, file.path.stem
        scene = next((name for name, root in roots.items() if root in path.parents), None)
        if scene is not None:
            inside[scene].append(file)
        elif path.suffix.lower() == ".zip":
            is_whole = plain_name(stem).startswith(plain_name(source.folder))  # of the data set, not of one scene
            archives.append(Package(str(path), [file], None if is_whole else source.scene(stem), is_archive=True))
        else:
            others.append(path)
    folders = [(str(root) if root.parts else name, name) for name, root in roots.items()]
    packages = [*(Package(title, inside[name], name, is_archive=False) for title, name in folders), *archives]
    if not packages:
        raise GetError(f"{source.page} shows no scene and no zip archive to the public, but {len(others)} other files")
    return [_alone(source, packages, name) for name in scenes] or packages, others


def _alone(source: PublishedDataset, packages: list[Package], name: str) -> Package:
    """Return the package of one scene, which holds no other. Raises GetError if there is none."""
    scene = source.scene(name)
    found = [package for package in packages if package.scene and package.scene.lower() == scene.lower()]
    if not found:
        raise GetError(
            f"no file of {source.folder} is of the scene {scene} alone; published are "
            f"{', '.join(p.name for p in packages)}: choose among single files, or leave --scene out"
        )
    return found[-1]


def scenes_in(
    source: PublishedDataset, paths: list[PurePosixPath], default: str, where: str
) -> dict[str, PurePosixPath]:
    """Return the topmost folders that hold what a scene holds, by the scenes' names.

    default: name of a scene without a folder. where: for messages. Raises BadFileError if two have one name.
    """
    scenes: dict[str, PurePosixPath] = {}
    roots = dict.fromkeys(root for path in paths if (root := _top(path)) is not None)  # in the order of first files
    for root in roots:
        if not any(above in roots for above in root.parents):
            name = source.scene(root.name or default)
            if scenes.setdefault(name, root) != root:
                raise BadFileError(f"{where} holds two scenes {name}: {scenes[name]} and {root}; unpack it by hand")
    return scenes


def unpack(archive: Path, folder: Path) -> list[PurePosixPath]:
    """Unpack a zip archive into a folder; return the paths of its files, without hidden files and file managers' ones.

    Raises BadFileError for what `opened_zip` refuses and for names that lead elsewhere, OSError for a full disk.
    """
    paths = []
    try:
        with opened_zip(archive) as members:
            for name, member in members.items():
                path = safe_path(name)
                if name.endswith("/") or _is_junk(path):
                    continue
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                with (folder / path).open("xb") as out:
                    out.writelines(member.chunks())
                paths.append(path)
    except ValueError as error:
        raise BadFileError(
            f"{archive} is refused: {shortened(str(error))}; nothing of it is in place; --force downloads it again"
        ) from error
    return paths


def _is_junk(path: PurePosixPath) -> bool:
    return any(part.startswith(".") or part in JUNK for part in path.parts)


def _top(path: PurePosixPath) -> PurePosixPath | None:
    """Return the folder of the scene that a file is in: the one above the first part that only scenes have."""
    for number, part in enumerate(path.parts):
        names = _FOLDERS if path.parts[number + 1 :] else _FILES
        if names.fullmatch(part.lower()):
            return PurePosixPath(*path.parts[:number])
    return None
