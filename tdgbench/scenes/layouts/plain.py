"""Folders of images beside a COLMAP model: RGBT-Scenes of ThermalGaussian, the layout of most captures, and TI-NSD.

RGBT-Scenes: chen-hangyu/Thermal-Gaussian-main 050c291, scene/dataset_readers.py and README.md. `colmap/sparse/0` is
where its model lies before it is moved. Files and model are paired by view name, so extensions may differ.

TI-NSD of Thermal3D-GS: thermal images alone. Its papers test every 8th image: `data.split=every_8th`.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import SUFFIXES
from tdgbench.scenes.inputs import is_folder
from tdgbench.scenes.layouts.layout import Images, Layout, SceneFiles, find_images, find_scene, model_folders
from tdgbench.scenes.registry import DATASETS

MODELS = ("sparse/0", "sparse", "colmap/sparse/0")


def _find(folder: Path, images: str, rgb: str | None = None) -> SceneFiles:
    """Find what is in a scene. images, rgb: names of the folders of thermal and RGB images."""
    layout = TI_NSD if rgb is None else RGBT_SCENES
    thermal = find_images(folder / images)
    if not thermal.paths:
        why = "; ".join([f"put one of each view there ({', '.join(SUFFIXES)})", *thermal.notes])
        raise SceneError(f"{folder / images} holds no image; {why}")
    photos = Images({}, {}, []) if rgb is None else find_images(folder / rgb)
    return find_scene(folder, MODELS, layout.title, ("thermal", "rgb"), thermal, photos)


RGBT_SCENES = Layout(
    "rgbt_scenes",
    DATASETS["rgbt_scenes"],
    "{rgb,thermal}/[train|test/]<view>.png, sparse/0 (COLMAP), [temperature.json]",
    lambda folder: is_folder(folder / "thermal"),
    partial(_find, images="thermal", rgb="rgb"),
)
TI_NSD = Layout(
    "ti_nsd",
    "TI-NSD",
    "images/<view>.png (thermal alone), sparse/0 (COLMAP)",
    lambda folder: is_folder(folder / "images") and bool(model_folders(folder, MODELS)),
    partial(_find, images="images"),
)
