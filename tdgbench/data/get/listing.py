"""The published files of a data set, of a Zenodo record or a Google Drive folder: list, group and download them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, NamedTuple

import gdown
import requests
from pydantic import BaseModel, Field

from tdgbench import __version__
from tdgbench.data.get.archives import is_junk, safe_path, stem
from tdgbench.data.get.sources import BadFileError, GetError, PublishedDataset
from tdgbench.data.progress import Count
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import check_scene_name
from tdgbench.scenes.registry import plain_name
from tdgbench.text import shortened

ZENODO = "https://zenodo.org"
AGENT = f"tdgbench/{__version__}"
TIMEOUT = (15.0, 60.0)  # s, for a connection and for bytes
RETRIES = 5  # after a cut connection; gdown waits longer and longer between them
FAILURES = (gdown.DownloadError, requests.RequestException)

# What the top of a scene holds, in the layouts of the authors' loaders (docs/data.md).
_FOLDERS = re.compile("sparse|colmap|colmap_sparse|rgb|thermal|warped_thermal|raw_images|images(_[0-9]+)?")
_FILES = re.compile("transforms(_thermal)?[.]json|temperature_bounds[.]json")


class RemoteFile(NamedTuple):
    """A published file.

    path: relative to the data set. size: in bytes; None if it is not published. identity: equal if and only if the
    content is: `md5:…` of the content, or `drive:…`.
    """

    path: PurePosixPath
    address: str
    size: int | None
    identity: str


@dataclass(frozen=True)
class Package:
    """Published files that become scenes together: one archive, or the files in the folder of a scene.

    name: for messages. scene: None if only the content of the archive tells.
    """

    name: str
    files: tuple[RemoteFile, ...]
    scene: str | None
    is_archive: bool

    @property
    def size(self) -> int | None:
        """Bytes to download; None if they are not published."""
        sizes = [file.size for file in self.files]
        return None if None in sizes else sum(size or 0 for size in sizes)

    @property
    def identities(self) -> dict[str, str]:
        return {str(file.path): file.identity for file in self.files}


class _Entry(BaseModel):
    """A file as Zenodo's API describes it; `links["self"]` is its address."""

    key: str
    size: Annotated[int, Field(ge=0, strict=True)]
    checksum: Annotated[str, Field(pattern="^md5:[0-9a-f]{32}$")]
    links: dict[str, str]


class _ZenodoRecord(BaseModel):
    files: list[_Entry]


def list_files(source: PublishedDataset, zenodo: str = ZENODO) -> list[RemoteFile]:
    """Return the published files of a data set. Raises GetError.

    zenodo: address of Zenodo, or of a mirror that speaks its API.
    """
    try:
        files = _zenodo_files(source, zenodo) if source.host == "Zenodo" else _drive_files(source)
    except (*FAILURES, KeyError, ValueError) as error:  # pydantic's are ValueError
        raise GetError(f"the files of {source.folder} cannot be listed: {reason_of(error)}") from error
    if not files:
        raise GetError(f"{source.page} shows no file to the public")
    return files


def packages_of(
    source: PublishedDataset, files: Iterable[RemoteFile], scenes: Iterable[str] = ()
) -> tuple[list[Package], list[PurePosixPath]]:
    """Group published files; return their packages, and the paths of files that belong to none.

    Files inside the folder of a scene belong to it, archives too. Other archives are packages if they can be unpacked.
    scenes: names; empty: all. Raises GetError for a scene that no package is of.
    """
    files = [file for file in files if not is_junk(file.path)]
    folders = by_scene(source, [file.path for file in files], source.folder, f"the published folder {source.folder}")
    packages, others = [], []
    for name, root in folders.items():
        inside = tuple(file for file in files if root in file.path.parents)
        packages.append(Package(str(root) if root.parts else name, inside, name, is_archive=False))
    for file in files:
        if any(root in file.path.parents for root in folders.values()):
            continue
        archive = stem(file.path.name)
        if archive is None:
            others.append(file.path)
        else:
            is_whole = plain_name(archive).startswith(plain_name(source.folder))  # of the data set, not of one scene
            scene = None if is_whole else source.scene(archive)
            packages.append(Package(str(file.path), (file,), scene, is_archive=True))
    wanted = [source.scene(scene) for scene in scenes]
    published = {package.scene.lower() for package in packages if package.scene}
    unknown = [scene for scene in wanted if scene.lower() not in published]
    if unknown:
        shown = ", ".join(package.name for package in packages)
        raise GetError(
            f"no file of {source.folder} is of the scene {unknown[0]} alone; published are {shown}: choose among the "
            "scenes that are single files, or leave --scene out"
        )
    if wanted:
        packages = [p for p in packages if p.scene and p.scene.lower() in map(str.lower, wanted)]
    return packages, others


def download(file: RemoteFile, target: Path, report: Count) -> None:
    """Download a file through gdown to `target`, unless it is there, and check its MD5 if that is published.

    gdown continues partial files and tries again after a cut connection; pooch begins each file anew.
    report: called with the number of bytes that are there. Raises GetError, OSError; BadFileError, with both sums, if
    the content is not what was published: it is discarded then.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    if not target.is_file():
        agent = AGENT if file.size is not None else None  # Google answers only browsers, as which gdown poses
        try:
            gdown.download(
                url=file.address, output=str(target), quiet=True, use_cookies=False, resume=True, timeout=TIMEOUT,
                retries=RETRIES, user_agent=agent, progress=lambda there, _: report(there),
            )  # fmt: skip
        except FAILURES as error:
            raise GetError(
                f"{file.path} cannot be fetched: {reason_of(error)}; what is there is kept, and the same command goes "
                "on from it (--force begins anew)"
            ) from error
    if file.identity.startswith("md5:"):
        with target.open("rb") as content:
            digest = f"md5:{hashlib.file_digest(content, 'md5').hexdigest()}"
        if digest != file.identity:
            target.unlink()
            raise BadFileError(
                f"{file.path} is damaged: its {digest}, published is {file.identity}; it was discarded: run the "
                "command again, which downloads it anew"
            )


def by_scene(
    source: PublishedDataset, paths: Iterable[PurePosixPath], default: str, where: str
) -> dict[str, PurePosixPath]:
    """Find the scenes among some files: the topmost folders that hold what a scene holds, by the scenes' names.

    default: name of a scene that lies at the top, without a folder. where: for messages. Raises BadFileError if two
    have one name, or one has a name that results cannot have.
    """
    scenes: dict[str, PurePosixPath] = {}
    roots = dict.fromkeys(root for path in paths if (root := _top(path)) is not None)  # in the order of first files
    for root in roots:
        if any(above in roots for above in root.parents):
            continue
        name = source.scene(root.name or default)
        try:
            check_scene_name(name)
        except SceneError as error:
            raise BadFileError(f"{where}: {error}") from error
        if name in scenes:
            raise BadFileError(f"{where} holds two scenes {name}: {scenes[name]} and {root}; unpack it by hand")
        scenes[name] = root
    return scenes


def reason_of(error: BaseException) -> str:
    """Say why a request failed: the system's words where there are any, else the library's, in one line."""
    inner: BaseException | None = error
    while inner is not None:
        if isinstance(inner, OSError) and not isinstance(inner, requests.RequestException) and inner.strerror:
            return inner.strerror
        inner = inner.__cause__ or inner.__context__
    return shortened(" ".join(str(error).split()))


def _zenodo_files(source: PublishedDataset, address: str) -> list[RemoteFile]:
    """Return the files of a record, as Zenodo's API gives them."""
    url = f"{address.rstrip('/')}/api/records/{source.identifier}"
    answer = requests.get(url, headers={"User-Agent": AGENT}, timeout=TIMEOUT)
    answer.raise_for_status()
    entries = _ZenodoRecord.model_validate_json(answer.content).files
    return [RemoteFile(safe_path(entry.key), entry.links["self"], entry.size, entry.checksum) for entry in entries]


def _drive_files(source: PublishedDataset) -> list[RemoteFile]:
    """Return files of a folder and its subfolders. Google gives neither sizes nor sums to a program without an account.

    gdown ≥ 6 lists any number of files; before, a folder's list ended after 50 without a word (its pull request 453).
    """
    listed = gdown.download_folder(
        id=source.identifier, quiet=True, use_cookies=False, skip_download=True, timeout=TIMEOUT
    )
    files = [(safe_path(Path(file.path).as_posix()), file.id) for file in listed if not isinstance(file, str)]
    return [RemoteFile(path, f"https://drive.google.com/uc?id={key}", None, f"drive:{key}") for path, key in files]


def _top(path: PurePosixPath) -> PurePosixPath | None:
    """Return the folder of the scene that a file is in: the one above the first part that only scenes have."""
    for number, part in enumerate(path.parts):
        names = _FOLDERS if path.parts[number + 1 :] else _FILES
        if names.fullmatch(part.lower()):
            return PurePosixPath(*path.parts[:number])
    return None
