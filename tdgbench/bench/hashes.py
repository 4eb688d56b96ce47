"""Hashes of the files of a cell that a record names."""

from __future__ import annotations

import hashlib
from pathlib import Path

from tdgbench.bench import cameras

HASHED = (".png", ".ply")


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every picture, model and camera file in a cell's folder, by relative path."""
    files = [p for p in sorted(folder.rglob("*")) if p.suffix in HASHED or p.name == cameras.FILE]
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
