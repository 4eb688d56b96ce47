"""Pictures of one test view: temperatures, errors, depth, and coverage by training views."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import torch
from PIL import Image

from tdgbench.bench.cameras import read_cameras
from tdgbench.bench.masks import has_mask, read_mask
from tdgbench.bench.paths import files_of
from tdgbench.bench.read_files import read_picture
from tdgbench.bench.renders import render_model
from tdgbench.scenes import Camera
from tdgbench.splats.ply import load_ply
from tdgbench.splats.view import Render

FILES = files_of("thermal")  # the report shows thermal images
THERMAL, ERROR, DEPTH, COVERAGE = "inferno", "magma", "viridis", "cividis"
ERROR_RANGE = 0.15  # upper end of the colour scale of errors
MIN_ALPHA = 0.5  # below, a pixel shows no surface
UNKNOWN = 128  # gray of pixels without a value
LEVELS = 256


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


@cache
def lookup_table(name: str) -> np.ndarray:
    """Return the colours (256, 3) uint8 of one of matplotlib's colour maps."""
    return (matplotlib.colormaps[name](np.linspace(0, 1, LEVELS))[:, :3] * 255 + 0.5).astype(np.uint8)


def colored(values: np.ndarray, name: str, low: float, high: float) -> np.ndarray:
    """Return values (H, W) in a perceptual colour map from `low` to `high`: (H, W, 3) uint8; gray where they are NaN.

    >>> colored(np.array([[-1.0, 0.5, 2.0, np.nan]], np.float32), "gray", 0, 1)[0, :, 0].tolist()
    [0, 128, 255, 128]
    """
    scaled = np.asarray(values, np.float32) - np.float32(low)
    scaled *= np.float32(LEVELS / max(high - low, 1e-12))
    np.clip(scaled, 0, LEVELS - 1, out=scaled)
    unknown = np.isnan(scaled) if np.isnan(scaled.sum()) else None
    with np.errstate(invalid="ignore"):
        picture = lookup_table(name).take(scaled.astype(np.uint8), axis=0)
    if unknown is not None:
        picture[unknown] = UNKNOWN
    return picture


def embedded(pixels: np.ndarray) -> str:
    """Return a picture (H, W, 3) uint8 as a data URI."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def in_colour(picture: np.ndarray) -> np.ndarray:
    """Return a stored picture (H, W, 1 or 3) uint8 in colour, (H, W, 3)."""
    return picture if picture.shape[2] == 3 else lookup_table(THERMAL)[picture[..., 0]]


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


def depth_of(folder: Path, view: str) -> tuple[np.ndarray, Camera]:
    """Return the expected z (H, W) of a cell's model in a test view, NaN without a surface, and the view's camera."""
    camera = read_cameras(folder)["test"][view]
    gaussians = load_ply(folder / FILES.model)
    return expected_depth(render_model(gaussians, camera, depth=True)), camera


def expected_depth(render: Render) -> np.ndarray:
    """Return the expected z (H, W) of a render with depth, NaN where there is no surface."""
    return torch.where(render.alpha > MIN_ALPHA, render.requested_depth / render.alpha, torch.nan).numpy()


def coverage(depth: np.ndarray, camera: Camera, others: list[Camera]) -> np.ndarray:
    """Return the number of other cameras that see each pixel's point (H, W), occluded or not; NaN without a point.

    depth: z (H, W) in scene units. Few training views constrain a region of low coverage.
    """
    rows, columns = np.indices(depth.shape) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.K).T
    local = rays * depth[..., None]
    to_world = np.linalg.inv(camera.world_to_camera)
    points = (local @ to_world[:3, :3].T + to_world[:3, 3]).reshape(-1, 3)
    count = np.zeros(len(points))
    for other in others:
        pixels, z = other.project(points)
        with np.errstate(invalid="ignore"):
            inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < other.width) & (pixels[:, 1] < other.height) & (z > 0)
        count += inside
    return np.where(np.isfinite(depth), count.reshape(depth.shape), np.nan)
