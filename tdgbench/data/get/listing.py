"""What is published: files of a Zenodo record or of a Google Drive folder, grouped into what is fetched together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, NamedTuple

import gdown
import requests
from pydantic import BaseModel, Field, ValidationError
from requests.adapters import HTTPAdapter
from urllib3 import Retry

from tdgbench import __version__
from tdgbench.data.get.archives import is_junk, safe_path, stem
from tdgbench.data.get.scenes import by_scene, scene_of_archive
from tdgbench.data.get.sources import GetError, PublishedDataset
from tdgbench.text import shortened

ZENODO = "https://zenodo.org"
AGENT = f"tdgbench/{__version__}"
TIMEOUT = (15.0, 60.0)  # s, for a connection and for bytes
RETRIES = Retry(  # of the list; a server may ask for hours with Retry-After
    3, backoff_factor=1.0, status_forcelist=[429, 500, 502, 503, 504], raise_on_status=False,
    respect_retry_after_header=False,
)  # fmt: skip
FAILURES = (gdown.DownloadError, requests.RequestException)
LONGEST_REASON = 200  # characters


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


class Listing(NamedTuple):
    """The packages of a data set, and the paths of published files that are not fetched."""

    packages: list[Package]
    others: list[PurePosixPath]  # no part of a scene, or archives of kinds that cannot be unpacked here


class _Entry(BaseModel):
    """A file as Zenodo's API describes it; the address is `links["self"]`."""

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
    except FAILURES as error:
        raise GetError(f"the files of {source.folder} cannot be listed: {reason_of(error)}") from error
    except (ValidationError, KeyError, ValueError) as error:
        raise GetError(
            f"the list of files of {source.folder} cannot be used: {shortened(str(error), LONGEST_REASON)}"
        ) from error
    if not files:
        raise GetError(f"{source.page} shows no file to the public")
    return files


def sort_out(source: PublishedDataset, files: Iterable[RemoteFile]) -> Listing:
    """Group published files. Files inside the folder of a scene belong to it, archives too. Raises GetError."""
    files = [file for file in files if not is_junk(file.path)]
    scenes = by_scene(source, [file.path for file in files], source.folder, f"the published folder {source.folder}")
    packages: list[Package] = []
    for name, root in scenes.items():
        inside = tuple(file for file in files if root in file.path.parents)
        packages.append(Package(str(root) if root.parts else name, inside, name, root))
    taken = {file.path for package in packages for file in package.files}
    rest = [file for file in files if file.path not in taken]
    for file in rest:
        if (archive := stem(file.path.name)) is not None:
            packages.append(Package(str(file.path), (file,), scene_of_archive(source, archive)))
    return Listing(packages, [file.path for file in rest if stem(file.path.name) is None])


def chosen(source: PublishedDataset, packages: list[Package], scenes: Iterable[str]) -> list[Package]:
    """Return packages of some scenes; all if none is named. Raises GetError for a scene that no package is of."""
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


def reason_of(error: BaseException) -> str:
    """Say why a request failed: the system's words where there are any, else the library's, in one line."""
    inner: BaseException | None = error
    while inner is not None:
        if isinstance(inner, OSError) and not isinstance(inner, requests.RequestException) and inner.strerror:
            return inner.strerror
        inner = inner.__cause__ or inner.__context__
    return shortened(" ".join(str(error).split()), LONGEST_REASON)


def _zenodo_files(source: PublishedDataset, address: str) -> list[RemoteFile]:
    """Return files of a record, as Zenodo's API gives them: `files[].key`, `.size`, `.checksum` and `.links.self`."""
    with requests.Session() as session:
        for protocol in ("http://", "https://"):
            session.mount(protocol, HTTPAdapter(max_retries=RETRIES))
        url = f"{address.rstrip('/')}/api/records/{source.identifier}"
        answer = session.get(url, headers={"User-Agent": AGENT}, timeout=TIMEOUT)
        answer.raise_for_status()
    entries = _ZenodoRecord.model_validate_json(answer.content).files
    return [RemoteFile(_checked(entry.key), entry.links["self"], entry.size, entry.checksum) for entry in entries]


def _drive_files(source: PublishedDataset) -> list[RemoteFile]:
    """Return files of a folder and its subfolders. Google gives neither sizes nor sums to a program without an account.

    gdown ≥ 6 lists any number of files; before, a folder's list ended after 50 without a word (its pull request 453).
    """
    found = gdown.download_folder(
        id=source.identifier, quiet=True, use_cookies=False, skip_download=True, timeout=TIMEOUT
    )
    files = []
    for file in found:
        assert not isinstance(file, str)  # with skip_download, gdown gives (id, path, local_path)
        address = f"https://drive.google.com/uc?id={file.id}"
        files.append(RemoteFile(_checked(Path(file.path).as_posix()), address, None, f"drive:{file.id}"))
    return files


def _checked(name: str) -> PurePosixPath:
    try:
        return safe_path(name)
    except ValueError as error:
        raise ValueError(f"the name {name!r} {error}") from error
