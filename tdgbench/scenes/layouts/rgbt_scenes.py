"""RGBT-Scenes of ThermalGaussian, as shipped; the layout of most captures.

Facts: chen-hangyu/Thermal-Gaussian-main 050c291, scene/dataset_readers.py and README.md: `rgb` and `thermal`, each
with `train` and `test`; views of the COLMAP model (`sparse/0`, or `colmap/sparse/0` before it is moved) that have no
file are passed over. Here files and model are paired by view name, so extensions may differ, and train/ and test/ may
be missing.
"""

from __future__ import annotations

from pathlib import Path

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import SUFFIXES
from tdgbench.scenes.inputs import is_folder, is_there
from tdgbench.scenes.layouts.layout import Found, Layout, find_files, find_model, find_optional
from tdgbench.scenes.temperature import FILE, read_radiometry

MODELS = ("sparse/0", "sparse", "colmap/sparse/0")
TITLE = "RGBT-Scenes"


def _fits(folder: Path) -> bool:
    return is_folder(folder / "thermal")


def _find(folder: Path) -> Found:
    if not _fits(folder):
        raise SceneError(f"{folder} has no thermal/ folder; the layout is {LAYOUT.looks}")
    thermal, shipped = find_files(folder / "thermal")
    if not thermal:
        raise SceneError(f"{folder / 'thermal'} holds no image; put one of each view there ({', '.join(SUFFIXES)})")
    rgb = find_optional(folder / "rgb", "RGB images")
    model = find_model(folder, MODELS, TITLE)
    files = [*model.files, *([folder / FILE] if is_there(folder / FILE) else [])]
    return Found(
        model.posed, model.points, thermal, rgb, shipped, read_radiometry(folder / FILE), files=files, notes=model.notes
    )  # fmt: skip


LAYOUT = Layout(
    "rgbt_scenes", TITLE, "{rgb,thermal}/[train|test/]<view>.png, sparse/0 (COLMAP), [temperature.json]", _fits, _find
)
