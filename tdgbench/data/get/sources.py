"""Where the authors publish their data sets, and how the files there are listed and downloaded."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Annotated, NamedTuple

import gdown
import requests
from pydantic import AliasPath, BaseModel, Field, NonNegativeInt

from tdgbench import __version__
from tdgbench.archives import safe_path
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.layouts import LAYOUTS
from tdgbench.scenes.registry import SCENES
from tdgbench.text import shortened

ZENODO, DRIVE = "https://zenodo.org", "https://drive.google.com"
AGENT = f"tdgbench/{__version__}"
TIMEOUT = (15.0, 60.0)  # s, for a connection and for bytes
RETRIES = 5  # after a cut connection; gdown waits longer and longer between them
FAILURES = (gdown.DownloadError, requests.RequestException)


class GetError(SceneError):
    """A data set cannot be fetched. The message names the file or the address, and the remedy."""


class BadFileError(GetError):
    """One file cannot be used; the others can still be fetched."""


class PublishedDataset(NamedTuple):
    """A published data set.

    page: the address for a browser, which ends in the identifier of a Zenodo record or of a Google Drive folder.
    authors: whom to ask if it is gone. known: when the address was last known to work or not, and by whom. holds: what,
    and under which licence.
    """

    dataset: str
    paper: str
    page: str
    authors: str
    known: str
    holds: str

    @property
    def folder(self) -> str:
        """Name of its folder in a data root."""
        return LAYOUTS[self.dataset].title

    def scene(self, folder: str) -> str:
        """Return the name of a scene: the paper's for a name or alias of one of its scenes, else the folder's.

        >>> SOURCES["thermalmix"].scene("hands"), SOURCES["thermalmix"].scene("panel")
        ('Hand', 'panel')
        """
        known = (scene.name for scene in SCENES if scene.dataset == self.dataset and scene.matches(folder))
        return next(known, folder)


BY_ZENODO = "licence: as the record states"
SOURCES = {
    source.dataset: source
    for source in (
        # mert-o/ThermalNeRFs, readme.md, d822bd1
        PublishedDataset(
            "thermalmix", "Özer et al. 2024", f"{ZENODO}/records/11065834",
            "github.com/mert-o/ThermalNeRFs", "April 2026: others name it as their source (SEAR 7a2e71b)",
            f"6 scenes, 5 of them the paper's, about 360 images; {BY_ZENODO}",
        ),
        # chen-hangyu/Thermal-Gaussian-main, README.md, 050c291; issue 14 is still open
        PublishedDataset(
            "rgbt_scenes", "Lu et al. 2024",
            f"{DRIVE}/drive/folders/1xuPwqezNW_LSB5C-H8TQFJ7nLoSS2BOg", "github.com/chen-hangyu/Thermal-Gaussian-main",
            "24 November 2025: readers report that it is gone (404); by its list, `sear` has the captures",
            "10 scenes, 7 of them the paper's, and an extension with GlassCup and DarkScenes; licence: not known here",
        ),
        # Schindler-EPFL-Lab/thermo-nerf, README.md, 08d9be9
        PublishedDataset(
            "thermoscenes", "Hassan et al. 2024", f"{ZENODO}/records/10835108",
            "github.com/Schindler-EPFL-Lab/thermo-nerf", "April 2026: others name it as their source (SEAR 7a2e71b)",
            f"16 scenes by its paper, none of them in TDg's; {BY_ZENODO}",
        ),
        # Schindler-EPFL-Lab/SEAR, README.md, d53ed32; docs/Dataset.md, 7a2e71b
        PublishedDataset(
            "sear", "Skorokhodov et al. 2026", f"{ZENODO}/records/19057885",
            "github.com/Schindler-EPFL-Lab/SEAR", "29 April 2026: its authors name it; not tried here",
            "scenes of RGBT-Scenes, ThermalMix, ThermoScenes and others, with cameras by VGGT and gray images: "
            f"scores of dataset=sear are none of theirs; {BY_ZENODO}",
        ),
    )
}  # fmt: skip


class RemoteFile(NamedTuple):
    """A published file. size: in bytes; 0: unknown. identity: `md5:…` or `drive:…`, equal for equal content alone."""

    path: PurePosixPath
    address: str
    size: int
    identity: str


class _Entry(BaseModel):
    """A file as Zenodo's API describes it; `links["self"]` is its address."""

    key: str
    size: NonNegativeInt
    checksum: Annotated[str, Field(pattern="^md5:[0-9a-f]{32}$")]
    links: dict[str, str]


class _ZenodoRecord(BaseModel):
    files: list[_Entry]
    licence: str = Field("", validation_alias=AliasPath("metadata", "license", "id"))


def list_files(source: PublishedDataset, zenodo: str = ZENODO) -> tuple[list[RemoteFile], str]:
    """Return the published files of a data set, and the licence that their record states. Raises GetError.

    zenodo: address of Zenodo, or of a mirror that speaks its API. Google gives neither sizes nor sums to a program
    without an account; gdown >= 6 lists any number of files (before, a list ended after 50: its pull request 453).
    """
    identifier = source.page.rpartition("/")[2]
    try:
        if source.page.startswith(DRIVE):
            found = gdown.download_folder(
                id=identifier, quiet=True, use_cookies=False, skip_download=True, timeout=TIMEOUT
            )
            paths = [(safe_path(Path(one.path).as_posix()), one.id) for one in found if not isinstance(one, str)]
            return [RemoteFile(path, f"{DRIVE}/uc?id={key}", 0, f"drive:{key}") for path, key in paths], ""
        url = f"{zenodo.rstrip('/')}/api/records/{identifier}"
        answer = requests.get(url, headers={"User-Agent": AGENT}, timeout=TIMEOUT)
        answer.raise_for_status()
        record = _ZenodoRecord.model_validate_json(answer.content)
        return [RemoteFile(safe_path(e.key), e.links["self"], e.size, e.checksum) for e in record.files], record.licence
    except (*FAILURES, KeyError, ValueError) as error:  # pydantic's are ValueError
        raise GetError(f"the files of {source.folder} cannot be listed: {_reason(error)}") from error


def download(file: RemoteFile, target: Path, report: Callable[[int], None]) -> None:
    """Download a file through gdown to `target`, unless it is there, and check its MD5 if that is published.

    gdown continues partial files and tries again after a cut connection; pooch begins each file anew.
    report: called with the number of bytes that are there. Raises GetError, OSError; BadFileError, with both sums, if
    the content is not what was published: it is discarded then.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    has_sum = file.identity.startswith("md5:")
    if not target.is_file():
        agent = AGENT if has_sum else None  # Google answers only browsers, as which gdown poses
        try:
            gdown.download(
                url=file.address, output=str(target), quiet=True, use_cookies=False, resume=True, timeout=TIMEOUT,
                retries=RETRIES, user_agent=agent, progress=lambda there, _: report(there),
            )  # fmt: skip
        except FAILURES as error:
            raise GetError(
                f"{file.path} cannot be fetched: {_reason(error)}; the same command resumes it, --force begins anew"
            ) from error
    if has_sum:
        with target.open("rb") as content:
            digest = f"md5:{hashlib.file_digest(content, 'md5').hexdigest()}"
        if digest != file.identity:
            target.unlink()
            raise BadFileError(
                f"{file.path} is damaged and was removed: its {digest}, published is {file.identity}; run it again"
            )


def _reason(error: Exception) -> str:
    """Return why a request failed, in one line: the system's words where requests quotes them."""
    said = re.search(r"\[Errno -?[0-9]+\] ([^'\")]+)", str(error))
    return shortened(said[1] if said else " ".join(str(error).split()))
