"""ThermalMix, as shipped: gray images of temperatures, warped into the RGB camera; or arrays that were made of them.

Facts of the download: mert-o/ThermalNeRFs e1d4e26, img_temp_mapper.py, which the authors' readme runs after it:
`warped_thermal/<view>.jpg` has the names of `thermal/<view>.jpg`, the images before the warp, and spans the scene's
PUBLISHED range; `warped_thermal/<view>.npy` in °C (`scenes/warped.py`) is what that script writes.

Facts of the loader: mert-o/thermalnerfs 140ea83, nerf/colmap_provider.py: the model is in the first of three places;
RGB in `images_<downscale>`, `rgb` or `images`, with `.jpg` on disk where the model says `.JPG`; it reads the arrays.
Views without files are left out. That loader takes cameras SIMPLE_RADIAL, SIMPLE_PINHOLE, PINHOLE and OPENCV and
ignores their distortion; here RGB, temperatures and masks are undistorted alike. Its `downscale` is 1 by default, so
`images_1` comes first and a smaller copy last.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_folder, listed
from tdgbench.scenes.layouts.layout import Images, Layout, SceneFiles, by_view, find_images, find_scene
from tdgbench.scenes.registry import registered
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.warped import PICTURES

MODELS = ("colmap_sparse/0", "sparse/0", "colmap/sparse/0")
WARPED = "warped_thermal"
UNWARPED = "thermal"
TITLE = "ThermalMix"

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
    found = find_scene(folder, MODELS, TITLE, ("rgb", UNWARPED), thermal, rgb)
    before = by_view(folder, find_images(folder / UNWARPED, PICTURES), found.posed).paths
    shown = {view for view, path in found.thermal.items() if path.suffix.lower() in PICTURES}
    unwarped = {view: path for view, path in before.items() if view in shown}
    return replace(found, in_celsius=True, files=[*found.files, *unwarped.values()], unwarped=unwarped)


def _rgb_folder(folder: Path) -> Path | None:
    """Return the folder of RGB images that the authors' loader takes, at the highest resolution, or None."""
    scales = [int(match[1]) for path in listed(folder) if (match := re.fullmatch(r"images_(\d{1,4})", path.name))]
    smaller = [f"images_{scale}" for scale in sorted(scales)]
    return next((folder / name for name in ("images_1", "rgb", "images", *smaller) if is_folder(folder / name)), None)


LAYOUT = Layout(
    "thermalmix",
    TITLE,
    f"{WARPED}/<view>.jpg (gray) with {UNWARPED}/<view>.jpg, or {WARPED}/<view>.npy (°C), rgb/ or images/, "
    "colmap_sparse/0, sparse/0 or colmap/sparse/0 (COLMAP)",
    lambda folder: is_folder(folder / WARPED),
    _find,
    published_range,
)
