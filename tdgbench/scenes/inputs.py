"""Input files and folders: opened only if they are regular files, listed only if they can be.

A FIFO, a device or a socket would block or never end; a loop of links or a missing permission is named.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tdgbench.files import KINDS, MB, content_of, opened
from tdgbench.scenes.errors import SceneError

MOST_BYTES = 4096 * MB  # of a file that is read at once; the points of a large survey have some hundred MB
LONGEST_NAME = 200  # bytes; names of files have 255 at most
ROWS_OF_AVERAGES = ("Average", "Average (Overall)")  # of tables; no scene has these names


def regular_file(path: Path) -> Path:
    """Return the path. Raises SceneError unless it is, or links to, a regular file; opens nothing.

    >>> regular_file(Path("/"))
    Traceback (most recent call last):
    tdgbench.scenes.errors.SceneError: / is a folder, not a file; replace it by the file itself
    """
    utf8_name(path)
    with _in_words(path, "used"):
        kind = stat.S_IFMT(path.stat().st_mode)
    if kind != stat.S_IFREG:
        raise SceneError(f"{path} is {KINDS.get(kind, 'no file')}, not a file; replace it by the file itself")
    return path


def is_there(path: Path) -> bool:
    """Return whether something has this name, be it a link to nothing."""
    return os.path.lexists(path)


def is_folder(path: Path) -> bool:
    """Return whether a folder is at `path`. Raises SceneError if that cannot be told."""
    with _in_words(path, "used"):
        return path.is_dir()


def listed(folder: Path) -> list[Path]:
    """List a folder, sorted by name. Raises SceneError if it cannot be listed."""
    with _in_words(folder, "listed"):
        return sorted(folder.iterdir())


def read_bytes(path: Path) -> bytes:
    """Read a regular file. Raises SceneError."""
    with _in_words(path, "read"):
        return content_of(regular_file(path), MOST_BYTES)


def read_json(path: Path) -> Any:
    """Read a JSON file. Raises SceneError for no regular file, ValueError or RecursionError for no JSON."""
    return json.loads(read_bytes(path).decode("utf-8-sig"))


def hash_of(path: Path) -> bytes:
    """Return SHA-256 of a regular file. Raises SceneError."""
    with _in_words(path, "read"), opened(regular_file(path)) as file:
        return hashlib.file_digest(file, "sha256").digest()


def read_array(path: Path) -> np.ndarray:
    """Read real numbers from an .npy file. Raises SceneError, before memory is taken for a shape that cannot be."""
    with decoding(path, "an .npy array", "write it with numpy.save"):
        return array_in(io.BytesIO(read_bytes(path)), path)


def array_in(file: BinaryIO, path: Path) -> np.ndarray:
    """Return the real numbers of an open .npy file. Raises SceneError, or what numpy raises."""
    shape, kind = array_header(file)
    if kind.kind not in "fiu":
        what = "Python objects" if kind.hasobject else kind
        raise SceneError(f"{path} holds {what}; it must hold one array of real numbers")
    start = file.tell()
    stated, there = math.prod(shape) * kind.itemsize, file.seek(0, os.SEEK_END) - start
    if stated < there and min(shape, default=0) >= 0:
        raise SceneError(f"{path} is longer than its array; it is damaged: write it again with numpy.save")
    if stated != there:
        raise ValueError(f"its header states {stated} bytes of values, and it has {there}")
    file.seek(0)
    values: np.ndarray = np.load(file, allow_pickle=False)
    return values


def array_header(file: BinaryIO) -> tuple[tuple[int, ...], np.dtype]:
    """Return shape and type of an open .npy file, which is then at the first value. Raises ValueError."""
    file.seek(0)
    major, _ = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
    shape, _, kind = read(file)
    return shape, kind


@contextmanager
def decoding(path: Path, what: str, remedy: str) -> Iterator[None]:
    """Turn the errors of a decoder, which are of many kinds, into SceneError: the file cannot be read as `what`."""
    try:
        yield
    except (SceneError, MemoryError):
        raise
    except Exception as error:
        reason = repr(error) if isinstance(error, LookupError) or not str(error) else error
        raise SceneError(f"{path} cannot be read as {what}: {reason}; {remedy}") from error


def utf8_name(path: Path) -> Path:
    """Return the path. Raises SceneError if its name is not UTF-8, which no record or table could hold."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise SceneError(f"the name of {str(path)!r} is not UTF-8; rename it") from error
    return path


def check_view_name(name: str, where: str) -> str:
    """Return a view's name. Raises SceneError, beginning with `where`, unless files of results can be named so."""
    if not name.strip() or name in (".", "..") or not name.isprintable() or len(name.encode()) > LONGEST_NAME:
        raise SceneError(
            f"{where} gives a view the name {name!r}; rename it: results are named after views, so names are of "
            f"printable characters and {LONGEST_NAME} bytes at most"
        )
    return name


def check_scene_name(name: str) -> str:
    """Return a scene's name. Raises SceneError for one that results cannot have."""
    utf8_name(Path(name))
    if is_hidden(name):
        raise SceneError(f"the scene {name} begins with a dot, as hidden folders do; rename its folder")
    if not name.strip() or not name.isprintable():
        raise SceneError(f"the scene {name!r} has a name that cannot be printed; rename its folder")
    if name in ROWS_OF_AVERAGES:
        raise SceneError(f"the scene {name} has the name of a row of the tables; rename its folder")
    return name


def is_hidden(name: str) -> bool:
    """Return whether a folder is hidden, so no scene: half of the commands would find results of hidden folders."""
    return name.startswith(".")


@contextmanager
def _in_words(path: Path, what: str) -> Iterator[None]:
    """Turn an error of the system into SceneError: the path cannot be `used`, `listed` or `read`, and why."""
    try:
        yield
    except (OSError, ValueError) as error:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        reason = getattr(cause, "strerror", None) or str(error)
        if isinstance(cause, FileNotFoundError) and path.is_symlink():
            reason = "it links to nothing; replace the link by the file"
        elif isinstance(cause, PermissionError):
            reason = "no permission to read it; change its permissions"
        raise SceneError(f"{path} cannot be {what}: {reason}") from error
