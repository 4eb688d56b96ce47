"""Machine-code cache: compiled kernels on disk, one folder per state of the sources and register width.

Numba checks only the file that defines a kernel, but a kernel bakes in helpers and constants of other files. Its
folder name therefore holds a fingerprint of the whole package `tdgbench.splats`, the only one that kernels import from.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import time
import uuid
from pathlib import Path

import numba

PACKAGE = Path(__file__).resolve().parents[1]
UNUSED_DAYS = 30  # after which the cache of another state of the sources is removed
_FOLDER = re.compile(r"[0-9a-f]{16}-\d+")
_DAY = 86_400.0  # seconds


def fingerprinted_files() -> list[Path]:
    """Source files that machine code may depend on."""
    return sorted(PACKAGE.rglob("*.py"))


def _fingerprint() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in fingerprinted_files():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_dir(lanes: int) -> Path:
    """Folder of the machine code of these sources for registers of `lanes` floats."""
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home) / "tdgbench" / "numba" / f"{_fingerprint()}-{lanes}"


def open_cache(lanes: int) -> Path:
    """Create the folder, mark it as used now, and remove its unused siblings; returns the folder.

    A read-only or full disk is no error here: Numba then reports what it cannot write.
    """
    folder = cache_dir(lanes)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        remove_unused(folder)
    except OSError:
        pass
    return folder


def remove_unused(folder: Path, days: float = UNUSED_DAYS) -> None:
    """Remove the siblings of a cache folder that no process opened for `days`.

    A folder is renamed before it is deleted, so that a process never finds half a cache. A process that still uses it
    has its kernels in memory; Numba recreates the folder for the next one it compiles.
    """
    for sibling in folder.parent.iterdir():
        if sibling == folder or not _FOLDER.fullmatch(sibling.name):
            continue
        try:
            if time.time() - sibling.stat().st_mtime > days * _DAY:
                doomed = sibling.with_name(f"removed-{uuid.uuid4().hex}")
                sibling.rename(doomed)
                shutil.rmtree(doomed, ignore_errors=True)
        except OSError:  # another process removed it first
            continue
