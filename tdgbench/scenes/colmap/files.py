"""Find and read the files of a COLMAP model, binary or text, with or without rigs and frames."""

from __future__ import annotations

from pathlib import Path

from tdgbench.scenes.colmap import binary, text
from tdgbench.scenes.colmap.tables import REMEDY, DamagedModelError, Tables, by_id
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_there

FORMATS = {".bin": binary, ".txt": text}  # in pycolmap's order of preference
NEEDED = ("cameras", "images", "points3D")


def read_tables(folder: Path) -> Tables:
    """Read a model's files. Raises SceneError naming the file and the remedy."""
    suffix = next((s for s in FORMATS if all(is_there(folder / (name + s)) for name in NEEDED)), None)
    if suffix is None:
        raise SceneError(f"{folder} is not a COLMAP model: {_missing(folder)}; {REMEDY}")
    reader = FORMATS[suffix]
    cameras, images, points, rigs, frames = (
        folder / (name + suffix) for name in ("cameras", "images", "points3D", "rigs", "frames")
    )
    if is_there(rigs) != is_there(frames):
        there, absent = (rigs, frames) if is_there(rigs) else (frames, rigs)
        raise DamagedModelError(there, f"{absent.name} is missing beside it")
    return Tables(
        folder,
        suffix,
        by_id(cameras, reader.read_cameras(cameras), "camera"),
        by_id(images, reader.read_images(images), "image"),
        reader.read_points(points),
        by_id(rigs, reader.read_rigs(rigs), "rig") if is_there(rigs) else {},
        by_id(frames, reader.read_frames(frames), "frame") if is_there(frames) else {},
    )


def _missing(folder: Path) -> str:
    """Which files the most complete format lacks."""
    lacking = {s: [name + s for name in NEEDED if not is_there(folder / (name + s))] for s in FORMATS}
    names = min(lacking.values(), key=len)
    return f"it has no {', '.join(names)}"
