"""TI-NSD of Thermal3D-GS: thermal images alone, in the plain layout of 3DGS.

Its papers test every 8th image: `data.split=every_8th`.
"""

from __future__ import annotations

from pathlib import Path

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import SUFFIXES
from tdgbench.scenes.inputs import is_folder, is_there
from tdgbench.scenes.layouts.layout import Found, Layout, find_files, find_model, model_folder
from tdgbench.scenes.temperature import FILE, read_radiometry

MODELS = ("sparse/0", "sparse", "colmap/sparse/0")
TITLE = "TI-NSD"


def _fits(folder: Path) -> bool:
    return is_folder(folder / "images") and model_folder(folder, MODELS) is not None


def _find(folder: Path) -> Found:
    if not is_folder(folder / "images"):
        raise SceneError(f"{folder} has no images/ folder; the layout is {LAYOUT.looks}")
    thermal, shipped = find_files(folder / "images")
    if not thermal:
        raise SceneError(f"{folder / 'images'} holds no image; put one of each view there ({', '.join(SUFFIXES)})")
    model = find_model(folder, MODELS, TITLE)
    files = [*model.files, *([folder / FILE] if is_there(folder / FILE) else [])]
    return Found(
        model.posed, model.points, thermal, {}, shipped, read_radiometry(folder / FILE), files=files, notes=model.notes
    )  # fmt: skip


LAYOUT = Layout("ti_nsd", TITLE, "images/<view>.png (thermal alone), sparse/0 (COLMAP)", _fits, _find)
