"""Whether RGB and thermal images are registered: the offset between edges of the same views, and what to do about it.

The edge maps of a view (gradient magnitudes, since signs differ between the modalities) are correlated over all shifts
up to 5 % of the width (16 px at least), and up to 15 % if none of these stands out. The mean over views has its peak at
the offset; resampling the views gives the spread of it.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ValidationError
from scipy import ndimage

from tdgbench.scenes import Scene, SceneError
from tdgbench.scenes.formats import header
from tdgbench.scenes.images import is_gray
from tdgbench.scenes.inputs import is_folder, is_there, listed, read_bytes

SMOOTHING = 1.5  # px, σ of the Gaussian before the gradient
STRONGEST = 99.0  # percentile of edges beyond which they count no more
LARGEST_SHIFTS, SHORTEST_RANGE = (0.05, 0.15), 16  # of the width, the second if the first is too small; px
FEWEST_VIEWS, MOST_VIEWS = 3, 24
SMALLEST = 96  # px, of the shorter side: measured on aligned images, errors were 0.4 px at 120 px, and 2 px at 36 px
MIN_PROMINENCE = 6.0  # of the peak over the other shifts, in their robust standard deviations
MAX_SPREAD = 3.0  # px
AROUND_PEAK = 6  # px that belong to the peak
RESAMPLINGS = 200
APART = 1.0  # px, from which images of a pair count as not registered
ALIGNED = 0.4  # px, largest offset that was measured on images that are aligned exactly
REPORT = "report.json"  # of data prepare, in the folder of the scene that it made
SIDES = ("left of", "right of"), ("above", "below")  # x and y, negative and positive
SHOWN = (".png", ".tif", ".tiff")  # of thermal images that data prepare reads without temperatures, too


class ViewPair(NamedTuple):
    """The two images of a view. rgb: (H, W, 3). thermal: (H, W, C). valid: (H, W) bool or None (all pixels)."""

    rgb: np.ndarray
    thermal: np.ndarray
    valid: np.ndarray | None = None


@dataclass(frozen=True)
class Offset:
    """How far edges of thermal images lie to the right (x) of and below (y) those of RGB images."""

    x: float  # px
    y: float
    spread: float  # px, 95 % of resamplings of the views lie this near
    views: int

    @property
    def px(self) -> float:
        """Length of the offset in px."""
        return float(np.hypot(self.x, self.y))


class _Prepared(BaseModel):
    """What the `Report` of a preparation says of the mapping."""

    source: str
    mapping: tuple[float, float, float]
    rgb_px: float


def chosen_views(count: int) -> set[int]:
    """Return the numbers of the views, of `count` in order, whose edges are compared."""
    return set(np.linspace(0, count - 1, min(MOST_VIEWS, count)).round().astype(int))


def edge_offset(pairs: Sequence[ViewPair]) -> Offset | str:
    """Return the offset between thermal and RGB edges over views of one scene, or words on why it is not known.

    All images have one size. An offset is trusted if the peak stands out of the correlations at other shifts, lies
    inside the searched range, and hardly moves when views are resampled.
    """
    if len(pairs) < FEWEST_VIEWS:
        return f"{len(pairs)} views with both images; {FEWEST_VIEWS} are needed"
    if min(pairs[0].rgb.shape[:2]) < SMALLEST:
        return f"images of {pairs[0].rgb.shape[1]}×{pairs[0].rgb.shape[0]} px are too small"
    for share in LARGEST_SHIFTS:
        radius = max(SHORTEST_RANGE, round(share * pairs[0].rgb.shape[1]))
        surfaces = np.stack([_edge_correlation(pair, radius) for pair in pairs])
        mean = surfaces.mean(axis=0)
        row, column = (int(place) for place in np.unravel_index(mean.argmax(), mean.shape))
        if min(row, column) == 0 or max(row, column) == 2 * radius:
            unknown = f"no offset below {radius} px fits"
        elif _prominence(mean, row, column) < MIN_PROMINENCE:
            unknown = "edges of RGB and thermal images have too little in common"
        else:
            break
    else:
        return unknown
    y, x = _peak(mean)
    spread = _spread(surfaces, y, x)
    if spread > MAX_SPREAD:
        return f"the offset differs between views, by {spread:.1f} px"
    return Offset(x, y, spread, len(pairs))


def registration(scene: Scene, offset: Offset) -> tuple[list[str], list[str]]:
    """Return doubts and notes on the registration of a scene's RGB and thermal images."""
    if offset.px <= APART:
        return [], []
    x, y = (
        f"{abs(value):.1f} px {side[int(value > 0)]}" for value, side in zip((offset.x, offset.y), SIDES, strict=True)
    )
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
        mapping = f"{ratio:.4g} {x - made.rgb_px * offset.x:.4g} {y - made.rgb_px * offset.y:.4g}"
        return f"Try: {again} {shlex.quote(made.source)} NEW --mapping {mapping}, with your other options as before"
    rgb, thermal = (_plain_files(folder / name) for name in ("rgb", "thermal"))
    if rgb and thermal and thermal[0].suffix.lower() in SHOWN and not is_there(folder / "masks"):
        scale = header(rgb[0], as_picture=True).width / scene.views[0].camera.width
        here = shlex.quote(str(folder))
        mapping = f"1 {-scale * offset.x:.4g} {-scale * offset.y:.4g}"
        return f"Try: {again} {here} NEW --poses {here} --mapping {mapping}"
    return (
        f"Register them again, with the thermal images moved by {-offset.x:+.1f}, {-offset.y:+.1f} px; of the camera's "
        f"files: {again} CAMERA_FILES NEW --mapping RATIO X Y (docs/prepare.md)"
    )


def _plain_files(folder: Path) -> list[Path]:
    """Return the files of a folder of images; none if it has subfolders, which `data prepare` does not read."""
    try:
        paths = [path for path in listed(folder) if not path.name.startswith(".")] if is_folder(folder) else []
    except SceneError:
        return []
    return [] if any(path.is_dir() for path in paths) else paths


def _edge_correlation(pair: ViewPair, radius: int) -> np.ndarray:
    """Return the correlation (2R + 1, 2R + 1) of a view's edge maps at shifts of -R to R px: rows are y, columns x."""
    rgb, thermal = (_edges(image, pair.valid) for image in (pair.rgb, pair.thermal))
    norm = np.linalg.norm(rgb) * np.linalg.norm(thermal)
    if norm == 0:
        return np.zeros((2 * radius + 1, 2 * radius + 1))
    from scipy import fft  # half a second, which a check without RGB images need not wait for

    shape = [fft.next_fast_len(max(size + radius, 2 * radius + 1), real=True) for size in rgb.shape]
    spectrum = np.conj(fft.rfft2(rgb, shape)) * fft.rfft2(thermal, shape)
    surface = np.roll(fft.irfft2(spectrum, shape), (radius, radius), axis=(0, 1))
    return surface[: 2 * radius + 1, : 2 * radius + 1] / norm


def _edges(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Return the edge map (H, W) of an image (H, W, C), with mean 0, faded out at borders and invalid pixels."""
    channels = [image[..., c].astype(np.float32) for c in range(1 if is_gray(image) else image.shape[2])]
    smooth = [ndimage.gaussian_filter(channel, SMOOTHING) for channel in channels]
    strength = np.sqrt(sum(np.square(change) for channel in smooth for change in np.gradient(channel)))
    strength = np.minimum(strength, np.percentile(strength, STRONGEST))
    weight = np.outer(np.hanning(strength.shape[0]), np.hanning(strength.shape[1]))
    if valid is not None:
        inside = ndimage.binary_erosion(valid, iterations=round(4 * SMOOTHING), border_value=1)
        weight = weight * ndimage.gaussian_filter(inside.astype(np.float32), SMOOTHING) * inside
    total = weight.sum()
    return weight * (strength - (weight * strength).sum() / total) if total > 0 else np.zeros_like(strength)


def _prominence(surface: np.ndarray, row: int, column: int) -> float:
    """Return how many robust standard deviations a peak lies above the other shifts, without slow changes."""
    surface = surface - ndimage.gaussian_filter(surface, AROUND_PEAK)
    rows, columns = np.indices(surface.shape)
    others = surface[np.hypot(rows - row, columns - column) > AROUND_PEAK]
    median = np.median(others)
    deviation = 1.4826 * np.median(np.abs(others - median))
    return float((surface[row, column] - median) / max(deviation, 1e-12))


def _peak(surface: np.ndarray) -> tuple[float, float]:
    """Return the sub-pixel position (y, x) of the highest value from the centre, by a parabola along each axis."""
    radius = surface.shape[0] // 2
    row, column = np.clip(np.unravel_index(surface.argmax(), surface.shape), 1, 2 * radius - 1)
    return (
        row - radius + _vertex(surface[row - 1 : row + 2, column]),
        column - radius + _vertex(surface[row, column - 1 : column + 2]),
    )


def _vertex(values: np.ndarray) -> float:
    """Return the vertex of the parabola through values at -1, 0 and 1."""
    curvature = values[0] - 2 * values[1] + values[2]
    return 0.0 if curvature >= 0 else float(np.clip((values[0] - values[2]) / (2 * curvature), -1, 1))


def _spread(surfaces: np.ndarray, y: float, x: float) -> float:
    """Return the distance within which 95 % of the peaks lie if views are drawn with replacement."""
    rng = np.random.default_rng(0)
    draws = rng.multinomial(len(surfaces), np.full(len(surfaces), 1 / len(surfaces)), RESAMPLINGS)
    peaks = [_peak(np.tensordot(draw, surfaces, axes=1)) for draw in draws]
    return float(np.percentile([np.hypot(py - y, px - x) for py, px in peaks], 95))
