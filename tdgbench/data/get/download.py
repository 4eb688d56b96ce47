"""Download one file through gdown, which continues partial files and tries again after a cut connection.

gdown fetches from any server; pooch, which also checks sums, begins each file anew.
"""

from __future__ import annotations

import glob
import hashlib
from pathlib import Path

import gdown

from tdgbench.data.get.listing import AGENT, FAILURES, TIMEOUT, RemoteFile, reason_of
from tdgbench.data.get.sources import BadFileError, GetError
from tdgbench.data.progress import Count

RETRIES = 5  # after a cut connection; gdown waits longer and longer between them


def download(file: RemoteFile, target: Path, report: Count) -> None:
    """Download a file to `target`, unless it is there, and check its MD5 if that is published.

    report: called with the number of bytes that are there. Raises GetError, OSError; BadFileError, with both sums, if
    the content is not what was published: it is discarded then.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    for part in partial_files(target):
        if file.size is not None and part.stat().st_size >= file.size:  # gdown would ask for what follows
            part.replace(target)
    if not target.is_file():
        _fetch(file, target, report)
    if file.identity.startswith("md5:"):
        with target.open("rb") as content:
            found = f"md5:{hashlib.file_digest(content, 'md5').hexdigest()}"
        if found != file.identity:
            target.unlink()
            raise BadFileError(
                f"{file.path} is damaged: its {found}, published is {file.identity}; it was discarded: run the command "
                "again, which downloads it anew"
            )


def partial_files(target: Path) -> list[Path]:
    """What gdown keeps of an unfinished download."""
    return list(target.parent.glob(f"{glob.escape(target.name)}????????.part"))


def _fetch(file: RemoteFile, target: Path, report: Count) -> None:
    agent = AGENT if file.size is not None else None  # Google answers only browsers, as which gdown poses
    try:
        gdown.download(
            url=file.address, output=str(target), quiet=True, use_cookies=False, resume=True, timeout=TIMEOUT,
            retries=RETRIES, user_agent=agent, progress=lambda there, _: report(there),
        )  # fmt: skip
    except FAILURES as error:
        raise GetError(
            f"{file.path} cannot be fetched: {reason_of(error)}; what is there is kept, and the same command goes on "
            "from it (--force begins anew)"
        ) from error
