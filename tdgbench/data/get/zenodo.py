"""List a Zenodo record. Its API gives the name, size, MD5 and address of each file.

Fields as pooch 1.9 (`ZenodoRepository`) and zenodo_get read them: `files[].key`, `.size`, `.checksum` (`md5:…`) and
`.links.self`.
"""

from __future__ import annotations

import json
import re
from typing import Any

import requests

from tdgbench.data.get.errors import GetError
from tdgbench.data.get.http import PATIENT, Attempts, Patience, RepeatableError, get
from tdgbench.data.get.remote import RemoteFile, first_clash, safe_path
from tdgbench.data.get.sources import Source

ADDRESS = "https://zenodo.org"
ATTEMPTS = 3  # nothing is lost if the list does not come, and a user without a network should know soon
LARGEST = 2**24  # bytes of an answer; a record has 100 files at most


def list_record(source: Source, address: str = ADDRESS, patience: Patience = PATIENT) -> list[RemoteFile]:
    """Files of a record. Raises GetError.

    address: of Zenodo, or of a mirror that speaks its API.
    """
    url = f"{address.rstrip('/')}/api/records/{source.identifier}"
    what = f"the list of files of {source.folder} ({url})"
    attempts = Attempts(patience._replace(attempts=min(patience.attempts, ATTEMPTS)), what)
    while True:
        try:
            content = _body(url, patience)
            break
        except (RepeatableError, requests.exceptions.RequestException) as error:
            attempts.failed(error)
    try:
        files = [_file(entry) for entry in json.loads(content)["files"]]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise GetError(
            f"{what} is not what Zenodo's API gives for a public record ({type(error).__name__}: {error}); open "
            f"{source.page} in a browser and unpack its files to {source.folder}/<Scene>"
        ) from error
    clash = first_clash(file.path for file in files)
    if clash or not files:
        problem = f"has two files of the name {clash}" if clash else "shows no file to the public"
        raise GetError(f"Zenodo record {source.identifier} {problem}; open {source.page} in a browser")
    return files


def _body(url: str, patience: Patience) -> bytes:
    content = bytearray()
    with get(url, patience, {"Accept": "application/json"}) as response:
        for chunk in response.iter_content(2**16):
            content += chunk
            if len(content) > LARGEST:
                raise GetError(f"{url} answers with more than {LARGEST} bytes; it is no list of files")
    return bytes(content)


def _file(entry: Any) -> RemoteFile:
    """A file as the API describes it. Raises ValueError, KeyError or TypeError."""
    name, size, checksum, url = entry["key"], entry["size"], entry["checksum"], entry["links"]["self"]
    if not isinstance(name, str):
        raise ValueError(f"the file name {name!r} is no text")
    path = safe_path(name)
    if isinstance(path, str) or len(path.parts) != 1:
        raise ValueError(f"the file name {name!r} {path if isinstance(path, str) else 'is no name'}")
    if type(size) is not int or size < 0:
        raise ValueError(f"{name} has the size {size!r}")
    if not re.fullmatch("md5:[0-9a-f]{32}", checksum):
        raise ValueError(f"{name} has the checksum {checksum!r}")
    if not re.match("https?://", url):
        raise ValueError(f"{name} has the address {url!r}")
    return RemoteFile(path, url, size, checksum)
