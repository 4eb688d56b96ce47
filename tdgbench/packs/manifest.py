"""`manifest.json` of a pack: its files, with sizes and hashes. The hash of the manifest names the pack.

A pack holds known kinds of files alone, under plain names, within limits that are checked before anything is read.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from tdgbench.archives import MOST_BYTES
from tdgbench.cells.paths import CAMERAS_FILE, CELL_FILE, RECORD_FILE
from tdgbench.cells.plan import PLAN_FILE
from tdgbench.cells.read_files import MAX_CAMERAS, MAX_PICTURE, MAX_TEXT
from tdgbench.cells.record import Sha256
from tdgbench.files import MB
from tdgbench.scenes import SceneError
from tdgbench.scenes.inputs import check_view_name

MANIFEST_FILE = "manifest.json"
SHOWN = 12  # digits of a pack's hash in its file's name
MOST_MANIFEST = 16 * MB  # a hundred thousand files
MOST_FILES = 100_000  # 140 cells of 40 test views have 25 000
MOST_CELLS = 1500  # the paper's tables with five seeds have 140
NAME = r"[\w][\w .,=+~()-]{0,99}"  # of an experiment: letters, digits and signs that no shell reads between quotes
FOLDER = re.compile(r"[\w,=+~-][\w.,=+~-]*")  # of a cell; `folder_name` makes no others
LEVELS = 5  # of folders of a cell below `cells`: method, data set, scene, initial points, seed


@dataclass(frozen=True)
class PackedFile:
    """Size in bytes and SHA-256 of a file."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    size: Annotated[int, Field(ge=0)]
    sha256: Sha256


@dataclass(frozen=True)
class Manifest:
    """experiment: its name. version: of tdgbench that packed it. files: by relative path."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    experiment: Annotated[str, Field(pattern=f"^{NAME}$")]
    version: Annotated[str, Field(pattern=r"^[\w.+-]{1,60}$")]
    files: dict[str, PackedFile]
    format: Literal[1] = 1

    def to_json(self) -> bytes:
        """Return the text of the file: equal manifests have equal bytes."""
        return (json.dumps(asdict(self), indent=1, sort_keys=True) + "\n").encode()


def plain_name(name: str) -> str:
    """Return the name of an experiment as a manifest may state it.

    >>> plain_name("table 1"), plain_name("+x"), plain_name("test\u00b2")
    ('table 1', '_+x', 'test_')
    """
    plain = re.sub(r"[^\w .,=+~()-]", "_", name, flags=re.ASCII)
    return (plain if re.match(r"\w", plain) else f"_{plain}")[:100]


def sha256(content: bytes) -> str:
    """Return SHA-256 of bytes. That of its manifest names a pack, as it decides everything in it."""
    return hashlib.sha256(content).hexdigest()


def read_manifest(text: bytes) -> Manifest:
    """Read a manifest. Raises ValueError for what is none, and for paths that lead out of the pack's folder."""
    try:
        manifest = TypeAdapter(Manifest).validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(f"{'.'.join([MANIFEST_FILE, *map(str, first['loc'])])}: {first['msg']}") from error
    for name in manifest.files:
        try:
            check_place(name)
        except (ValueError, SceneError) as error:
            raise ValueError(f"{MANIFEST_FILE}: {error}") from error
    return manifest


def check_place(name: str) -> None:
    """Raise ValueError unless a relative path is that of a file that packs hold."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or path.as_posix() != name:
        raise ValueError(f"{name!r} is no place in the pack")
    folders, file = path.parts[1 : LEVELS + 1], "/".join(path.parts[LEVELS + 1 :])
    is_of_cell = path.parts[0] == "cells" and len(folders) == LEVELS and all(map(FOLDER.fullmatch, folders))
    if name != PLAN_FILE and not (is_of_cell and CELL_FILE.fullmatch(file)):
        raise ValueError(f"{name!r} is no file of a cell")
    if path.suffix == ".png":
        check_view_name(path.stem, "it")


def most_bytes(name: str) -> int:
    """Return how many bytes a file may have, by its kind."""
    path, kinds = PurePosixPath(name), {".json": MAX_TEXT, ".csv": MAX_TEXT, ".png": MAX_PICTURE}
    return MAX_CAMERAS if path.name == CAMERAS_FILE else kinds.get(path.suffix, MOST_BYTES)


def check_amount(names: Collection[str]) -> None:
    """Raise ValueError for more files or cells than a pack may hold."""
    cells = sum(name.endswith(f"/{RECORD_FILE}") for name in names)
    for count, most, what in ((len(names), MOST_FILES, "files"), (cells, MOST_CELLS, "cells")):
        if count > most:
            raise ValueError(f"it holds {count:,} {what}, more than {most:,}")
