"""ThermalMix, as shipped: gray images of temperatures, warped into the RGB camera; or arrays that were made of them.

Facts of the download: mert-o/ThermalNeRFs e1d4e26, img_temp_mapper.py, which makes `warped_thermal/<view>.npy` in °C
of `warped_thermal/<view>.jpg`, which spans the scene's PUBLISHED range, and of `thermal/<view>.jpg` before the warp.

Facts of the loader: mert-o/thermalnerfs 140ea83, nerf/colmap_provider.py: the model is in the first of three places;
RGB in `images_<downscale>` (1 by default, so a smaller copy comes last), `rgb` or `images`. It ignores the lens's
distortion; here RGB, temperatures and masks are undistorted alike.

Fillers: the authors raise pixels that are darker than all pixels before the warp to that minimum; here they are masked.
By the noise of JPEG, measured pixels may be a few levels below the minimum, and fillers spoil their blocks. So a region
below the minimum is filler, and grows to whole blocks, if as many of its pixels as a block has are nearer to black than
to the minimum; others are raised. A minimum that is nearly black tells nothing: then, and without an image before the
warp, fillers are found as in arrays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import ndimage

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.fillers import grown
from tdgbench.scenes.formats import decode
from tdgbench.scenes.formats.pictures import JPEG
from tdgbench.scenes.images import unit_image
from tdgbench.scenes.inputs import is_folder, listed
from tdgbench.scenes.layouts.layout import Images, Layout, SceneFiles, by_view, find_images, find_scene
from tdgbench.scenes.registry import DATASETS, registered
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import Radiometry
from tdgbench.scenes.thermal import Temperatures, ThermalRequest, measured_images, read_temperatures
from tdgbench.scenes.view_images import ThermalImages
from tdgbench.text import first_few

MODELS = ("colmap_sparse/0", "sparse/0", "colmap/sparse/0")
WARPED = "warped_thermal"
UNWARPED = "thermal"
PICTURES = (".jpg", ".jpeg", ".png")
BLOCK = 8  # px, side of a JPEG's blocks
NOISE = 4 / 255  # image value; minima below it cannot be told from black
MOST_COLOR = 8 / 255  # image value; by which channels of a gray image may differ
LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R 601, as OpenCV reads colour images as gray

# °C of black and white. Source: `min_max` of mert-o/ThermalNeRFs e1d4e2647a, img_temp_mapper.py.
PUBLISHED = {
    "face": TemperatureRange(22.5, 35.2),
    "hand": TemperatureRange(22.1, 33.6),
    "panel": TemperatureRange(22.7, 55.8),  # no scene of Table 1
    "lion": TemperatureRange(16.8, 48.3),
    "pan": TemperatureRange(19.4, 129.8),
    "laptop": TemperatureRange(21.6, 40.2),
}


def published_range(name: str) -> TemperatureRange | None:
    """Return °C of black and white in a scene's gray images, by its name or an alias; None of other scenes.

    >>> published_range("Hands")
    TemperatureRange(min=22.1, max=33.6)
    """
    with suppress(SceneError):  # of a scene that is not of Table 1
        name = registered(name).name
    return PUBLISHED.get(name.lower())


def _find(folder: Path) -> SceneFiles:
    arrays, pictures = (find_images(folder / WARPED, suffixes) for suffixes in ((".npy",), PICTURES))
    thermal = Images({**pictures.paths, **arrays.paths}, {**pictures.shipped, **arrays.shipped}, [])
    if not thermal.paths:
        raise SceneError(
            f"{folder / WARPED} holds no image and no array; put <view>.jpg (gray) or <view>.npy (°C, (H, W)) of each "
            "view there"
        )
    photos = _rgb_folder(folder)
    rgb = Images({}, {}, []) if photos is None else find_images(photos)
    found = find_scene(folder, MODELS, LAYOUT.title, ("rgb", UNWARPED), thermal, rgb)
    before = by_view(folder, find_images(folder / UNWARPED, PICTURES), found.posed).paths
    shown = {view for view, path in found.thermal.items() if _is_picture(path)}
    unwarped = {view: path for view, path in before.items() if view in shown}
    read = partial(_read_thermal, unwarped=unwarped)
    return replace(found, files=[*found.files, *unwarped.values()], read_thermal=read)


def _rgb_folder(folder: Path) -> Path | None:
    """Return the folder of RGB images that the authors' loader takes, at the highest resolution, or None."""
    scales = [int(match[1]) for path in listed(folder) if (match := re.fullmatch(r"images_(\d{1,4})", path.name))]
    smaller = [f"images_{scale}" for scale in sorted(scales)]
    return next((folder / name for name in ("images_1", "rgb", "images", *smaller) if is_folder(folder / name)), None)


def _read_thermal(request: ThermalRequest, unwarped: Mapping[str, Path]) -> ThermalImages:
    """Read temperatures from arrays, and from gray images of a known range."""
    pictures = [name for name, source in request.sources.items() if _is_picture(source.path)]
    if not pictures:
        return measured_images(request, request.reader)
    notes, how = [], "gray, of known °C"
    if request.radiometry is None:
        published = published_range(request.scene)
        stated = published or request.window
        if stated is None:
            raise SceneError(
                f"{request.sources[pictures[0]].path.parent} holds gray images, and no temperatures of black and white "
                "are published for a scene of this name; set data.temperature=[min,max] in °C, or add temperature.json"
            )
        if published is not None:
            how = f"gray; black and white are {published.min:g} and {published.max:g} °C, as published"
        request = replace(request, radiometry=Radiometry(stated))
    if arrays := len(request.sources) - len(pictures):
        notes.append(f"{arrays} views are read from arrays, {len(pictures)} from gray images: {first_few(pictures)}")
    alone = [name for name in pictures if name not in unwarped]
    mask = request.options.fillers is None
    if alone and mask:
        notes.append(
            f"{len(alone)} gray images have none from before the warp; only constant fillers are found: "
            f"{first_few(alone)}"
        )
    assert request.radiometry is not None
    before = {request.sources[name].path: path for name, path in unwarped.items() if name in request.sources}
    read = partial(_read_warped, radiometry=request.radiometry, unwarped=before, mask=mask)
    images = measured_images(request, read)
    return replace(images, notes=[*notes, *images.notes], assumed={**images.assumed, "values": how})


def _read_warped(path: Path, radiometry: Radiometry, unwarped: Mapping[Path, Path], mask: bool) -> Temperatures:
    """Read temperatures from an array, or from a warped gray image, whose fillers are masked or else raised.

    unwarped: images before the warp by that of the warped one.
    """
    if not _is_picture(path):
        return read_temperatures(path, radiometry.scale)
    image, before = _gray(path, radiometry), unwarped.get(path)
    block = BLOCK if path.suffix.lower() in JPEG else 1
    filler = None
    if before is not None:
        lowest = float(_gray(before, radiometry).min())
        if mask and lowest >= NOISE:
            filler = filler_below(image, lowest, block)
        image = np.maximum(image, np.float32(lowest))
    span = radiometry.range
    degC = (span.min * (1 - image.astype(np.float64)) + span.max * image).astype(np.float32)
    if filler is not None:
        degC[filler] = np.nan
    return Temperatures(degC, filler is not None, block, ends=True)


def _gray(path: Path, radiometry: Radiometry) -> np.ndarray:
    """Return the image (H, W) float32 in [0, 1]. Raises SceneError for one in colours."""
    image = unit_image(decode(path, as_picture=True), path, radiometry)
    if np.ptp(image, axis=2).max() > MOST_COLOR:
        raise SceneError(
            f"{path} is in colours, but temperatures are read from gray images; replace it by the gray image, or "
            f"put {path.stem}.npy in °C beside it"
        )
    return image[..., 0] if image.shape[2] == 1 else image @ LUMA


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in PICTURES


def filler_below(image: np.ndarray, lowest: float, block: int) -> np.ndarray:
    """Return pixels (H, W) bool of an image (H, W) that are a warp's filler, or spoiled by it.

    lowest: of the image before the warp. block: side of the blocks in which a filler spoils its neighbours, px.
    """
    labels, count = ndimage.label(image < lowest)
    dark = np.bincount(labels[image <= lowest / 2], minlength=count + 1)
    is_filler = dark >= BLOCK**2
    is_filler[0] = False  # pixels that are not below the minimum
    return grown(is_filler[labels], block)


LAYOUT = Layout(
    "thermalmix",
    DATASETS["thermalmix"],
    f"{WARPED}/<view>.jpg (gray) with {UNWARPED}/<view>.jpg, or {WARPED}/<view>.npy (°C), rgb/ or images/, "
    "colmap_sparse/0, sparse/0 or colmap/sparse/0 (COLMAP)",
    lambda folder: is_folder(folder / WARPED),
    _find,
)
