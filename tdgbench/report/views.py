"""Pictures of one test view: temperatures, errors, depth, and coverage by training views."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from pathlib import Path

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

FILES = files_of("thermal")  # the report shows thermal images
THERMAL, ERROR, DEPTH, COVERAGE = "inferno", "magma", "viridis", "cividis"
ERROR_RANGE = 0.15  # upper end of the colour scale of errors
MIN_ALPHA = 0.5  # below, a pixel shows no surface


def middle_view(folders: Iterable[Path]) -> str:
    """Return the name of the middle test view that any of these cells has a render of; empty without any."""
    names = sorted({path.stem for folder in folders for path in (folder / FILES.renders).glob("*.png")})
    return names[len(names) // 2] if names else ""


def colored(values: np.ndarray, name: str, low: float, high: float) -> np.ndarray:
    """Return values (H, W) in a perceptual colour map: (H, W, 3) uint8; gray where they are not finite.

    >>> colored(np.array([[np.nan]]), "inferno", 0, 1).tolist()
    [[[128, 128, 128]]]
    """
    span = max(high - low, 1e-12)
    mapped = matplotlib.colormaps[name](np.clip((np.nan_to_num(values) - low) / span, 0, 1))[..., :3]
    mapped[~np.isfinite(values)] = 0.5
    return (mapped * 255 + 0.5).astype(np.uint8)


def embedded(pixels: np.ndarray) -> str:
    """Return a picture (H, W, 3) uint8 as a data URI."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def thermal_picture(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return a stored picture in colour, (H, W, 3) uint8, and its values (H, W, C) in [0, 1]."""
    stored = read_picture(path)
    values = stored.astype(np.float64) / 255
    return (stored if stored.shape[2] == 3 else colored(stored[..., 0] / 255, THERMAL, 0, 1)), values


def grayed(pixels: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Return a picture (H, W, 3) uint8 that is gray where the mask (H, W) is false."""
    return pixels if valid is None else np.where(valid[..., None], pixels, np.uint8(128))


def error_map(image: np.ndarray, truth: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Return the mean absolute difference (H, W) over the channels of two images (H, W, C); NaN where not `valid`."""
    error = np.abs(image - truth).mean(axis=2)
    return error if valid is None else np.where(valid, error, np.nan)


def stored_mask(folder: Path, view: str, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return the mask (H, W) of a test view with pictures of this shape (H, W, …); None if all pixels are valid."""
    return read_mask(folder, view, (shape[1], shape[0])) if has_mask(folder, view) else None


def depth_of(folder: Path, view: str) -> tuple[np.ndarray, Camera]:
    """Return the expected z (H, W) of a cell's model in a test view, NaN without a surface, and the view's camera."""
    camera = read_cameras(folder)["test"][view]
    gaussians = load_ply(folder / FILES.model)
    render = render_model(gaussians, camera, depth=True)
    alpha = 1 - render.transmittance
    return torch.where(alpha > MIN_ALPHA, render.requested_depth / alpha, torch.nan).numpy(), camera


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
