"""Zip archives made in memory."""

from __future__ import annotations

import io
import zipfile

import numpy as np


def scene_files(folder: str, views: int = 2, seed: int = 0) -> dict[str, bytes]:
    """Names and contents of files of a small scene; they are no images, and do not compress."""
    random = np.random.default_rng(seed)
    names = [f"{kind}/{view:04}.jpg" for kind in ("rgb", "thermal") for view in range(views)]
    prefix = f"{folder}/" if folder else ""
    return {f"{prefix}{name}": random.bytes(30_000) for name in (*names, "sparse/0/cameras.bin")}


def zipped(files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """A zip archive."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, compression)
    return out.getvalue()
