"""ThermoScenes of ThermoNeRF, nerfstudio's transforms.json with a thermal image per frame; and SEAR's compilation.

Facts: Schindler-EPFL-Lab/thermo-nerf 08d9be9, thermo_nerf/thermal_nerf/thermal_dataparser.py and
thermo_scenes/docs/Collect_new_dataset.md. Without `thermal_file_path`, a frame's thermal image is the file of the same
name in `thermal/`. The shipped split is that of `<split>_filenames`, or of file names with `train` or `eval`.

SEAR (Schindler-EPFL-Lab/SEAR 7a2e71b, docs/Dataset.md): pairs of images as frames, with cameras by VGGT, and gray
images made of the cameras' radiometric files.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import SUFFIXES
from tdgbench.scenes.inputs import is_there, read_bytes, regular_file
from tdgbench.scenes.layouts.layout import Images, Layout, SceneFiles, by_view, find_images, find_masks, model_folders
from tdgbench.scenes.layouts.transforms import POINTS, Transforms, read_points, read_transforms, there, where_they_are
from tdgbench.scenes.temperature import BOUNDS_FILE, FILE, read_radiometry, temperature_file

PAIR, HEAD = re.compile(rb'"(rgb|thermal)"\s*:\s*\{'), 4096  # bytes
JSON_FILES = ("transforms.json", "transforms_thermal.json")


def _fits(folder: Path) -> bool:
    """Return whether a folder has a transforms.json and no COLMAP model where RGBT-Scenes has it."""
    return _json_file(folder) is not None and not model_folders(folder, ("sparse/0", "sparse"))


def _has_pairs(folder: Path) -> bool:
    """Return whether a transforms.json begins as SEAR's do."""
    path = _json_file(folder)
    return path is not None and _fits(folder) and PAIR.search(read_bytes(path)[:HEAD]) is not None


def _find(folder: Path) -> SceneFiles:
    path = _json_file(folder)
    if path is None:
        raise SceneError(f"{folder} has no {JSON_FILES[0]}; the layout is {LAYOUT.looks}")
    content = read_transforms(path)
    thermal, rgb, stated, notes = _files(folder, path, content)
    bounds = read_radiometry(temperature_file(folder))
    files = [path, *(folder / name for name in (BOUNDS_FILE, FILE) if is_there(folder / name))]
    if bounds is None:
        notes.append(f"there is no {BOUNDS_FILE}, so no temperature of image values is known")
    masks, about, unread = find_masks(folder, content.posed, (thermal, rgb), stated)
    notes += unread
    assumed = {**content.assumed, **about}
    ply, points = folder / (content.points or POINTS), None
    if is_there(ply):
        cloud, colors = read_points(ply)
        cameras = [image.camera for image in content.posed.values()]
        points, moved = where_they_are(cloud, content.applied_transform, cameras)
        notes += [f"{ply.name} was in the world before applied_transform, which is applied to it"] if moved else []
        files.append(ply)
        assumed |= {"colours": f"of {ply.name}: {colors}"} if colors else {}
    elif content.points is not None:
        notes.append(f"{path.name} names the points {content.points}, which are not there")
    shipped = _shipped(content)
    return SceneFiles(content.posed, points, thermal, rgb, shipped, bounds, None, files, notes, masks, assumed)


def _files(
    folder: Path, path: Path, content: Transforms
) -> tuple[dict[str, Path], dict[str, Path], dict[str, Path], list[str]]:
    """Return files by view name, of thermal images, RGB images and stated masks; and notes."""
    unnamed = any(frame.thermal_file_path is None for frame in content.frames.values())
    images = find_images(folder / "thermal") if unnamed else Images({}, {}, [])
    by_name = by_view(folder, images, content.posed).paths
    thermal, rgb, masks = {}, {}, {}
    for name, frame in content.frames.items():
        where = f"{path}: frame {name}"
        own = frame.thermal_file_path
        place = by_name.get(name) if own is None else there(folder / own)
        if place is not None:
            thermal[name] = _image(place, where)
        photo = there(folder / frame.file_path)
        if photo is not None and (place is None or not photo.samefile(place)):
            rgb[name] = _image(photo, where)
        if frame.mask_path is not None:
            masks[name] = _image(folder / frame.mask_path, where)
    if not thermal:
        raise SceneError(
            f"{path} names no thermal image that is there (read as {LAYOUT.title}); put <view>.png of each frame into "
            f"{folder / 'thermal'}, or name it with thermal_file_path"
        )
    return thermal, rgb, masks, images.notes


def _json_file(folder: Path) -> Path | None:
    return next((folder / name for name in JSON_FILES if is_there(folder / name)), None)


def _image(path: Path, where: str) -> Path:
    if path.suffix.lower() not in SUFFIXES:
        raise SceneError(f"{where} names {path}, which is none of {', '.join(SUFFIXES)}; export it as one of them")
    return regular_file(path)


def _shipped(content: Transforms) -> dict[str, str]:
    """Return `train` or `test` by view name. Lists of names decide; `val` is tested where `test` is not."""
    if content.lists:
        test = content.lists.get("test") or content.lists.get("val", [])
        parts: Mapping[str, Any] = {"train": content.lists.get("train", []), "test": test}
        return {name: part for part, names in parts.items() for name in names}
    bases = {name: image.key.rpartition("/")[2] for name, image in content.posed.items()}
    said = {name: base for name, base in bases.items() if "train" in base or "eval" in base}
    return {name: "train" if "train" in base else "test" for name, base in said.items()}


LAYOUT = Layout(
    "thermoscenes",
    "ThermoScenes",
    f"transforms.json (nerfstudio), images/, thermal/, {BOUNDS_FILE}, [{POINTS}]",
    lambda folder: _fits(folder) and not _has_pairs(folder),
    _find,
)
SEAR = Layout("sear", "SEAR", "transforms.json of pairs (SEAR), images/, thermal/", _has_pairs, _find)
