"""Read a scene in the RGBT-Scenes folder layout, which all data sets here share.

    <scene>/thermal/[train|test/]<view>.png    rgb/[train|test/]<view>.jpg    sparse/0/    [temperature.json]

Thermal and RGB files are paired by view name; extensions may differ. Poses come from the COLMAP model.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tdgbench.scenes.colmap import RegisteredImage, read_model
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import SUFFIXES, Radiometry, image_size, is_gray, read_image, read_radiometry, resize
from tdgbench.scenes.inputs import check_view_name, hash_of, is_folder, is_there, listed, regular_file
from tdgbench.scenes.scene import Scene, View
from tdgbench.scenes.splits import split_names
from tdgbench.scenes.validate import check_camera

LAYOUT = "<scene>/{rgb,thermal}/[train|test]/<view>.png, <scene>/sparse/0 (COLMAP), [<scene>/temperature.json]"
ASPECT_TOLERANCE = 0.01
WIDEST = 16384  # px, of resized images


FolderPath = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f]+$")]  # of a data set; no control characters


@dataclass(frozen=True)
class ReadOptions:
    """Options of reading a scene.

    split: one of splits.SPLITS. width: of the resized images, px; None keeps their size. channels: of the thermal
    images: 1, 3 or "auto" (1 if all are gray). skip_unpaired: omit posed views without a thermal image; else they are
    an error.
    """

    split: Literal["eighty_twenty", "every_8th", "folder"] = "eighty_twenty"
    width: Annotated[int, Field(ge=1, le=WIDEST)] | None = None
    channels: Literal["auto", 1, 3] = "auto"
    skip_unpaired: bool = False


@dataclass(frozen=True)
class Description:
    """How results identify a scene."""

    scene: str
    dataset: str
    group: str  # a key of registry.GROUPS, or empty


def find_images(folder: Path) -> tuple[dict[str, Path], dict[str, str]]:
    """Image paths by view name; and by view name `train` or `test`, where these subfolders exist.

    Raises SceneError for a name that no result could have, and for what is no regular file.
    """
    paths: dict[str, Path] = {}
    shipped: dict[str, str] = {}
    subfolders = [name for name in ("train", "test") if is_folder(folder / name)]
    for sub in subfolders or [""]:
        for path in listed(folder / sub):
            if path.suffix.lower() not in SUFFIXES or path.name.startswith("."):
                continue
            check_view_name(path.stem, f"{path.parent}: the file {path.name!r}")
            regular_file(path)
            if path.stem in paths:
                raise SceneError(f"{path} and {paths[path.stem]} are both view {path.stem}; keep one of them")
            paths[path.stem] = path
            if sub:
                shipped[path.stem] = sub
    return paths, shipped


def read_scene(folder: Path, description: Description, options: ReadOptions) -> Scene:
    """Read the scene in a folder. Raises SceneError naming the file or view and the remedy."""
    if not is_folder(folder / "thermal"):
        raise SceneError(f"{folder} has no thermal/ folder; the layout is {LAYOUT}")
    thermal, shipped = find_images(folder / "thermal")
    if not thermal:
        raise SceneError(f"{folder / 'thermal'} holds no image; put one of each view there ({', '.join(SUFFIXES)})")
    rgb = _find_rgb(folder / "rgb")
    model_folder = next((f for f in (folder / "sparse" / "0", folder / "sparse") if is_folder(f)), None)
    if model_folder is None:
        raise SceneError(f"{folder} has no COLMAP model in sparse/0; run COLMAP on its RGB images first")
    posed, points, notes = read_model(model_folder)
    unposed = sorted(set(thermal) - set(posed))
    if unposed:
        notes.append(f"{len(unposed)} thermal images have no pose and are omitted: {', '.join(unposed[:5])}")
    unpaired = sorted(set(posed) - set(thermal))
    if unpaired and not options.skip_unpaired:
        raise SceneError(
            f"{folder}: {len(unpaired)} views of the COLMAP model have no thermal image ({', '.join(unpaired[:5])}); "
            "add them, or set data.skip_unpaired=true"
        )
    if unpaired:
        notes.append(f"{len(unpaired)} posed views have no thermal image and are omitted: {', '.join(unpaired[:5])}")
    names = sorted(set(posed) & set(thermal))
    if not names:
        raise SceneError(
            f"{folder}: no thermal image has the name of a view of {model_folder} "
            f"(thermal: {sorted(thermal)[:2]}, COLMAP: {sorted(posed)[:2]})"
        )
    try:
        train, test = split_names(names, options.split, shipped)
    except ValueError as error:
        raise SceneError(f"{folder}: {error}") from error
    for name in names:
        check_image_size(thermal[name], posed[name])
        posed[name].check_undistortion()
    radiometry = read_radiometry(folder / "temperature.json")
    channels = _decide_channels([thermal[n] for n in names], radiometry, options.channels)
    views = {
        n: _make_view(posed[n], thermal[n], rgb.get(n), folder / "depth", radiometry, channels, options) for n in names
    }
    return Scene(
        name=description.scene,
        dataset=description.dataset,
        group=description.group,
        train=[views[n] for n in train],
        test=[views[n] for n in test],
        points=points,
        temperature=None if radiometry is None else radiometry.range,
        split=options.split,
        fingerprint=_fingerprint(folder, [*thermal.values(), *rgb.values()], model_folder),
        channels=channels,
        notes=notes,
        folder=folder,
    )


def check_image_size(path: Path, posed: RegisteredImage) -> None:
    """Raise SceneError unless the image's header has the aspect ratio of its camera; decode nothing."""
    width, height = image_size(path)
    source = posed.source_size
    if abs(width / height * source[1] / source[0] - 1) > ASPECT_TOLERANCE:
        raise SceneError(
            f"{path} is {width}×{height}, but its camera is {source[0]}×{source[1]}: the aspect ratios differ; "
            "export the image again, or correct the camera"
        )


def _find_rgb(folder: Path) -> dict[str, Path]:
    """RGB images by view name; none without the folder."""
    if not is_there(folder):
        return {}
    if not is_folder(folder):
        raise SceneError(f"{folder} is no folder; replace it by a folder of RGB images, or remove it")
    return find_images(folder)[0]


def _decide_channels(paths: list[Path], radiometry: Radiometry | None, wanted: int | str) -> int:
    if wanted == "auto":
        return 1 if all(is_gray(read_image(path, radiometry)) for path in paths) else 3
    if wanted not in (1, 3):
        raise SceneError(f"data.channels is {wanted!r}; it must be auto, 1 or 3")
    return int(wanted)


def _make_view(posed: RegisteredImage, thermal: Path, rgb: Path | None, depth_folder: Path, radiometry, channels: int,
               options: ReadOptions) -> View:  # fmt: skip
    camera = posed.camera
    if options.width is not None:
        camera = camera.resized(options.width, max(1, round(camera.height * options.width / camera.width)))
        check_camera(camera, f"data.width={options.width}: view {posed.name}")
    depth = depth_folder / f"{posed.name}.npy"
    return View(
        name=posed.name,
        camera=camera,
        load_thermal=partial(_load, thermal, posed, camera.width, camera.height, channels, radiometry),
        load_rgb=None if rgb is None else partial(_load, rgb, posed, camera.width, camera.height, 3, None),
        thermal_path=thermal,
        true_depth_path=regular_file(depth) if is_there(depth) else None,
    )


def _load(path: Path, posed: RegisteredImage, width: int, height: int, channels: int, radiometry) -> np.ndarray:
    """Image of a view as float32 (height, width, channels): read, undistorted, resized, converted."""
    check_image_size(path, posed)
    image = read_image(path, radiometry)
    if posed.undistortion is not None:
        image = posed.undistortion.apply(image)
    image = resize(image, width, height)
    if channels == 1 and image.shape[2] == 3:
        image = image[..., :1] if is_gray(image) else image.mean(axis=2, keepdims=True)
    if channels == 3 and image.shape[2] == 1:
        image = np.repeat(image, 3, axis=2)
    return np.ascontiguousarray(image, np.float32)


def _fingerprint(folder: Path, images: list[Path], model: Path) -> str:
    """Hash of the paths and contents of the images, the COLMAP model and temperature.json."""
    digest = hashlib.sha256()
    extra = [folder / "temperature.json"] if is_there(folder / "temperature.json") else []
    for path in sorted([*images, *(p for p in listed(model) if p.is_file()), *extra]):
        content = hash_of(path)
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
        digest.update(content)
    return digest.hexdigest()[:16]
