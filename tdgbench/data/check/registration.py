"""What the offset of edges says of a scene: whether RGB and thermal images are registered, and what to do if not."""

from __future__ import annotations

import shlex
from pathlib import Path

from pydantic import BaseModel, ValidationError

from tdgbench.data.check.alignment import Offset
from tdgbench.scenes import Scene, SceneError
from tdgbench.scenes.formats import header
from tdgbench.scenes.inputs import is_folder, is_there, listed, read_bytes

APART = 1.0  # px, from which images of a pair count as not registered
ALIGNED = 0.4  # px, largest offset that was measured on images that are aligned exactly
REPORT = "report.json"  # of data prepare, in the folder of the scene that it made
SIDES = ("left of", "right of"), ("above", "below")  # x and y, negative and positive
SHOWN = (".png", ".tif", ".tiff")  # of thermal images that data prepare reads without temperatures, too


class _Prepared(BaseModel):
    """What a preparation's report says of the mapping, see `Report`."""

    source: str
    mapping: tuple[float, float, float]
    rgb_px: float


def registration(scene: Scene, offset: Offset) -> tuple[list[str], list[str]]:
    """Return doubts and notes on the registration of a scene's RGB and thermal images."""
    if offset.px <= APART:
        return [], []
    x, y = (f"{abs(value):.1f} px {side[int(value > 0)]}" for value, side in zip(offset[:2], SIDES, strict=True))
    said = f"thermal edges lie {x} and {y} those of the RGB images (x {offset.x:+.1f}, y {offset.y:+.1f}, "
    said += f"± {offset.spread:.1f} px, {offset.views} views)"
    if offset.px - offset.spread <= ALIGNED:
        return [], [f"{said}, which may be chance: the views differ too much to tell whether they are registered"]
    cost = "they are not registered, and a method that trains on both learns from wrong pairs"
    return [f"{said}: {cost}. {_try(scene, offset)}"], []


def _try(scene: Scene, offset: Offset) -> str:
    """Return the command that moves the thermal images onto the RGB images."""
    folder = scene.folder
    assert folder is not None  # scenes that are checked are files
    again = "tdgbench data prepare"
    try:
        made = _Prepared.model_validate_json(read_bytes(folder / REPORT)) if is_there(folder / REPORT) else None
    except ValidationError:  # of a scene whose mapping is a homography, or of another program's report
        made = None
    if made is not None:
        ratio, x, y = made.mapping
        moved = _numbers(ratio, x - made.rgb_px * offset.x, y - made.rgb_px * offset.y)
        return f"Try: {again} {shlex.quote(made.source)} NEW --mapping {moved}, with your other options as before"
    rgb, thermal = (_plain_files(folder / name) for name in ("rgb", "thermal"))
    if rgb and thermal and thermal[0].suffix.lower() in SHOWN and not is_there(folder / "masks"):
        scale = header(rgb[0], as_picture=True).width / scene.views[0].camera.width
        here = shlex.quote(str(folder))
        moved = _numbers(1, -scale * offset.x, -scale * offset.y)
        return f"Try: {again} {here} NEW --poses {here} --mapping {moved}"
    return (
        f"Register them again, with the thermal images moved by {-offset.x:+.1f}, {-offset.y:+.1f} px; of the camera's "
        f"files: {again} CAMERA_FILES NEW --mapping RATIO X Y (docs/data.md)"
    )


def _plain_files(folder: Path) -> list[Path]:
    """Return the files of a folder of images; none if it has subfolders, which `data prepare` does not read."""
    try:
        paths = [path for path in listed(folder) if not path.name.startswith(".")] if is_folder(folder) else []
    except SceneError:
        return []
    return [] if any(path.is_dir() for path in paths) else paths


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.4g}" for value in values)
