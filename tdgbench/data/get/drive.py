"""List and download a Google Drive folder through gdown.

Google publishes neither sizes nor sums of a folder's files to a program without an account. A program is refused while
many others download the same files; a browser may still get them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath

import gdown
import requests

from tdgbench.data.get.errors import GetError
from tdgbench.data.get.http import PATIENT, Patience, reason_of
from tdgbench.data.get.remote import RemoteFile, first_clash, safe_path
from tdgbench.data.get.sources import Source
from tdgbench.text import shortened

MOST_SHOWN = 200  # characters of gdown's reason
_ERRORS = (gdown.DownloadError, requests.exceptions.RequestException)


def list_folder(source: Source, patience: Patience = PATIENT) -> list[RemoteFile]:
    """Files of a folder and its subfolders. Raises GetError.

    gdown ≥ 6 lists any number of files; before, a folder's list ended after 50 without a word (its pull request 453).
    """
    timeout = (patience.connect_seconds, patience.read_seconds)
    try:
        found = gdown.download_folder(
            id=source.identifier, quiet=True, use_cookies=False, skip_download=True, timeout=timeout
        )
    except _ERRORS as error:
        raise _by_browser(source, "cannot be listed", error) from error
    files = []
    for one in found:
        assert not isinstance(one, str)  # with skip_download, gdown gives (id, path, local_path)
        path = safe_path(Path(one.path).as_posix())
        if isinstance(path, str):
            raise GetError(
                f"the Google Drive folder of {source.folder} holds {one.path!r}, which {path}; {_help(source)}"
            )
        files.append(RemoteFile(path, one.id, None, f"drive:{one.id}"))
    clash = first_clash(file.path for file in files)
    if clash or not files:
        problem = f"holds several files of the name {clash}" if clash else "is empty"
        raise GetError(f"the Google Drive folder of {source.folder} {problem}; {_help(source)}")
    return files


def download(source: Source, file: RemoteFile, target: Path, patience: Patience, report: Callable[[int], None]) -> None:
    """Download a file to `target`, unless it is there; a partial file is resumed. Raises GetError, OSError.

    report: called with the number of bytes that are there.
    """
    if target.is_file():  # gdown would ask for it before it looks
        return
    timeout = (patience.connect_seconds, patience.read_seconds)
    try:
        gdown.download(
            id=file.address, output=str(target), quiet=True, use_cookies=False, resume=True, timeout=timeout,
            retries=patience.attempts - 1, progress=lambda there, _: report(there),
        )  # fmt: skip
    except _ERRORS as error:
        raise _by_browser(source, f"does not give {file.path}", error) from error


def _by_browser(source: Source, problem: str, error: Exception) -> GetError:
    """The error for what a program cannot get."""
    reason = " ".join(reason_of(error).split()).removeprefix("Failed to retrieve file url: ")
    return GetError(
        f"the Google Drive folder of {source.folder} {problem}: {shortened(reason, MOST_SHOWN)} "
        f"What is there already is kept, and the same command goes on from it. If it keeps failing, {_help(source)}"
    )


def _help(source: Source) -> str:
    scenes = PurePosixPath(source.folder, "<Scene>")
    return (
        f"open {source.page} in a browser, download the scenes and put them into {scenes} of your data folder. If the "
        f"page is gone, ask its authors ({source.authors})"
    )
