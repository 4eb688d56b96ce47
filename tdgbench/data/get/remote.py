"""A file of a published data set, before it is downloaded; names that a file may have."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from pathlib import PurePosixPath, PureWindowsPath
from typing import NamedTuple

LONGEST_NAME = 255  # bytes; the limit of most file systems


class RemoteFile(NamedTuple):
    """A published file.

    path: relative to the data set. address: a URL, or a Google Drive identifier. size: in bytes; None if it is not
    published. identity: equal if and only if the content is: `md5:…` of the content, or `drive:…`.
    """

    path: PurePosixPath
    address: str
    size: int | None
    identity: str


def safe_path(name: str) -> PurePosixPath | str:
    """The path of a member of an archive or listing below its top, or what is wrong with its name.

    >>> safe_path("./lion/rgb/1.jpg"), safe_path("lion/../../x")
    (PurePosixPath('lion/rgb/1.jpg'), 'leads out of its folder')
    """
    try:
        name.encode()
    except UnicodeEncodeError:
        return "is not UTF-8"
    if not name.isprintable():
        return "has characters that cannot be printed"
    if "\\" in name:
        return "has a backslash"
    if name.startswith("/") or PureWindowsPath(name).drive:
        return "is an absolute path"
    path = PurePosixPath(name)
    if ".." in path.parts:
        return "leads out of its folder"
    if any(len(part.encode()) > LONGEST_NAME for part in path.parts):
        return f"is longer than {LONGEST_NAME} bytes"
    return path


def first_clash(paths: Iterable[PurePosixPath]) -> PurePosixPath | None:
    """The first of some files that a file system could take for an earlier one, or for the folder of one; else None.

    Case and the Unicode forms of a letter are ignored, as macOS and Windows do.

    >>> first_clash([PurePosixPath("a/B"), PurePosixPath("a/b")])
    PurePosixPath('a/b')
    """
    files: set[str] = set()
    folders: set[str] = set()
    for path in paths:
        plain = _plain(path)
        above = {_plain(parent) for parent in path.parents} - {"."}
        if plain in files or plain in folders or above & files:
            return path
        files.add(plain)
        folders |= above
    return None


def _plain(path: PurePosixPath) -> str:
    return unicodedata.normalize("NFC", unicodedata.normalize("NFD", str(path)).casefold())
