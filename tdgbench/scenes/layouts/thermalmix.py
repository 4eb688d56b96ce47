"""ThermalMix, as shipped: temperatures as arrays, warped into the RGB camera.

Facts: mert-o/thermalnerfs 140ea83, nerf/colmap_provider.py: the model is in the first of three places; RGB in
`images_<downscale>`, `rgb` or `images`, with `.jpg` on disk where the model says `.JPG`; `warped_thermal/<view>.npy`
holds °C. Views without files are left out. That loader takes cameras SIMPLE_RADIAL, SIMPLE_PINHOLE, PINHOLE and OPENCV
and ignores their distortion; here RGB, temperatures and masks are undistorted alike. Its `downscale` is 1 by default,
so `images_1` comes first and a smaller copy last.
"""

from __future__ import annotations

import re
from pathlib import Path

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_folder, is_there, listed
from tdgbench.scenes.layouts.layout import Found, Layout, find_files, find_model
from tdgbench.scenes.temperature import FILE, read_radiometry

MODELS = ("colmap_sparse/0", "sparse/0", "colmap/sparse/0")
ARRAYS = "warped_thermal"
TITLE = "ThermalMix"


def _fits(folder: Path) -> bool:
    return is_folder(folder / ARRAYS)


def _find(folder: Path) -> Found:
    if not _fits(folder):
        raise SceneError(f"{folder} has no {ARRAYS}/ folder; the layout is {LAYOUT.looks}")
    arrays, shipped = find_files(folder / ARRAYS, (".npy",))
    if not arrays:
        raise SceneError(f"{folder / ARRAYS} holds no array; put <view>.npy of each view there, in °C (H, W)")
    photos = _rgb_folder(folder)
    model = find_model(folder, MODELS, TITLE)
    files = [*model.files, *([folder / FILE] if is_there(folder / FILE) else [])]
    rgb = {} if photos is None else find_files(photos)[0]
    return Found(
        model.posed, model.points, arrays, rgb, shipped, read_radiometry(folder / FILE), True, files, model.notes
    )  # fmt: skip


def _rgb_folder(folder: Path) -> Path | None:
    """The folder of RGB images that the authors' loader takes, at the highest resolution; None if there is none."""
    scales = [int(match[1]) for path in listed(folder) if (match := re.fullmatch(r"images_(\d{1,4})", path.name))]
    smaller = [f"images_{scale}" for scale in sorted(scales)]
    return next((folder / name for name in ("images_1", "rgb", "images", *smaller) if is_folder(folder / name)), None)


LAYOUT = Layout(
    "thermalmix",
    TITLE,
    f"{ARRAYS}/<view>.npy (°C), rgb/ or images/, colmap_sparse/0, sparse/0 or colmap/sparse/0 (COLMAP)",
    _fits,
    _find,
)
