"""Download a file through pooch, which checks its sum, with a downloader that resumes."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pooch
import requests

from tdgbench.data.get.errors import BadFileError, GetError
from tdgbench.data.get.http import Attempts, Patience, RepeatableError, get
from tdgbench.data.get.remote import RemoteFile

CHUNK = 2**16  # bytes; at most one chunk is lost when a connection is cut
PART = ".part"


class ResumingDownloader:
    """A downloader for `pooch.retrieve` that goes on from a partial file.

    pooch's own ones begin anew: their temporary file is removed at every error. Here bytes go to `part`, which outlives
    a cut connection, a full disk and a killed process; pooch's temporary file becomes a link to it once it is complete.

    size: of the whole file in bytes. report: called with the number of bytes that are there.
    """

    def __init__(self, part: Path, size: int, patience: Patience, report: Callable[[int], None]) -> None:
        self.part, self.size, self.patience, self.report = part, size, patience, report

    def __call__(self, url: str, output_file: str, _pooch: Any) -> None:
        attempts = Attempts(self.patience, url)
        self.part.touch()
        furthest = self._there()
        while (there := self._there()) < self.size:
            try:
                self._continue(url, there)
                if self._there() < self.size:
                    raise RepeatableError(f"the server sent {self._there()} of {self.size} bytes")
            except (RepeatableError, requests.exceptions.RequestException) as error:
                if self._there() > furthest:  # a server that makes it begin anew must not do so for ever
                    furthest = self._there()
                    attempts.succeeded()
                attempts.failed(error)
        Path(output_file).unlink()
        try:
            os.link(self.part, output_file)  # a rename would lose it if pooch is interrupted while it computes the sum
        except OSError:  # a file system without links
            self.part.replace(output_file)

    def _there(self) -> int:
        """Bytes that are there. A part that is too long is of another file, and goes."""
        there = self.part.stat().st_size
        if there > self.size:
            self._begin_anew()
            there = 0
        self.report(there)
        return there

    def _continue(self, url: str, there: int) -> None:
        """Append the bytes from `there` on; a server that cannot resume begins anew."""
        with get(url, self.patience, {"Range": f"bytes={there}-"} if there else None) as response:
            if response.status_code == requests.codes.requested_range_not_satisfiable:
                self._begin_anew()
                raise RepeatableError(f"the server has no byte {there} of this file")
            if response.status_code != requests.codes.partial_content:
                there = 0
            self._check(response.headers, there)
            if not there:
                self._begin_anew()
            with self.part.open("ab") as file:
                for chunk in response.iter_content(CHUNK):
                    there += len(chunk)
                    if there > self.size:
                        break
                    file.write(chunk)
                    self.report(there)
        if there > self.size:
            self._begin_anew()
            raise GetError(f"{url} is longer than the {self.size} bytes that are published; nothing of it is kept")

    def _check(self, headers: Mapping[str, str], there: int) -> None:
        """Raise RepeatableError, before a byte is changed, if an answer is not this file from `there` on.

        It may be the page of a network that wants a password first.
        """
        length = headers.get("Content-Length", str(self.size - there))
        if length != str(self.size - there):
            raise RepeatableError(f"the server offers {length} bytes instead of {self.size - there}")
        if there and not re.match(rf"bytes {there}-", headers.get("Content-Range", "")):
            raise RepeatableError("the server offers another part than was asked for")

    def _begin_anew(self) -> None:
        with self.part.open("wb"):
            pass


def download(file: RemoteFile, target: Path, patience: Patience, report: Callable[[int], None]) -> None:
    """Download a file of known size and MD5 to `target`, unless it is there already. Raises GetError, OSError.

    Raises BadFileError, with both sums, if the content is not what was published; it is discarded then.
    """
    assert file.size is not None
    pooch.get_logger().setLevel(logging.WARNING)
    part = target.with_name(target.name + PART)
    downloader = ResumingDownloader(part, file.size, patience, report)
    try:
        pooch.retrieve(file.address, file.identity, target.name, target.parent.absolute(), downloader=downloader)
    except ValueError as error:
        if "does not match the known hash" not in str(error):
            raise
        part.unlink(missing_ok=True)
        found = re.search(r"but got '?([0-9a-f]{32})", str(error))
        raise BadFileError(
            f"{file.path} is damaged: its MD5 is {found[1] if found else 'another'}, published is "
            f"{file.identity.removeprefix('md5:')}; it was discarded: run the command again, which downloads it anew"
        ) from error
    part.unlink(missing_ok=True)
