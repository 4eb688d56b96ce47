"""Pictures of one test view: temperatures, errors, depth, and where the model guesses."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from tdgbench.bench.cameras import read_cameras
from tdgbench.bench.colours import UNKNOWN, expected_depth
from tdgbench.bench.masks import has_mask, read_mask
from tdgbench.bench.paths import files_of
from tdgbench.bench.read_files import read_picture
from tdgbench.bench.renders import determinacy_of, render_model
from tdgbench.splats.ply import load_ply

FILES = files_of("thermal")  # the report shows thermal images
ERROR, DEPTH = "magma", "viridis"
ERROR_RANGE = 0.15  # upper end of the colour scale of errors


class StoredView(NamedTuple):
    """Ground truth and render of a test view, (H, W, 1 or 3) uint8, and their mask (H, W); None if all are valid.

    error: (H, W) mean absolute difference over the channels, of values in [0, 1]; NaN where not `valid`.
    """

    truth: np.ndarray
    render: np.ndarray
    error: np.ndarray
    valid: np.ndarray | None


def middle_view(folders: Iterable[Path]) -> str:
    """Return the name of the middle test view that any of these cells has a render of; empty without any."""
    names = sorted({path.stem for folder in folders for path in (folder / FILES.renders).glob("*.png")})
    return names[len(names) // 2] if names else ""


def embedded(pixels: np.ndarray) -> str:
    """Return a picture (H, W, 3) uint8 as a data URI."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def grayed(pixels: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Return a picture (H, W, 3) uint8 that is gray where the mask (H, W) is false."""
    return pixels if valid is None else np.where(valid[..., None], pixels, np.uint8(UNKNOWN))


def stored_view(folder: Path, view: str) -> StoredView:
    """Return the stored pictures of a test view. Raises ValueError where one is missing or unusable."""
    truth, image = (read_picture(folder / sub / f"{view}.png") for sub in (FILES.targets, FILES.renders))
    if truth.shape != image.shape:
        raise ValueError(f"{folder}: {FILES.targets} and {FILES.renders} of {view} differ in size")
    valid = read_mask(folder, view, (truth.shape[1], truth.shape[0])) if has_mask(folder, view) else None
    error = np.abs(image / 255 - truth / 255).mean(axis=2)
    return StoredView(truth, image, error if valid is None else np.where(valid, error, np.nan), valid)


def geometry_of(folder: Path, view: str) -> tuple[np.ndarray, np.ndarray]:
    """Return z (H, W) of a cell's model in a test view, NaN without a surface, and the determinacy (H, W)."""
    cameras, gaussians = read_cameras(folder), load_ply(folder / FILES.model)
    camera = cameras["test"][view]
    determinacy = determinacy_of(gaussians, cameras["train"].values()).image(camera).numpy()
    return expected_depth(render_model(gaussians, camera, depth=True)), determinacy
