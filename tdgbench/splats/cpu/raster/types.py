"""Input of the kernels: Gaussians, camera and options; and the data types that the two passes exchange.

Arrays are cut into spans (first, count), one per thread; the rows between spans are unused.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from tdgbench.splats.cpu.adam import NO_STALE, Stale
from tdgbench.splats.cpu.raster.dense import to_rows
from tdgbench.splats.cpu.scratch import Workspace, empty_rows
from tdgbench.splats.gaussians import COLORS_AT, OPACITY_AT
from tdgbench.splats.view import Blending

# Layout of a splat, a projected Gaussian as 16 floats, one cache line. U_, V_: image mean in px, counted from the first
# pixel of the box, which keeps its digits. A_, B_, C_ and LOG2_OPACITY: log2(alpha) = log2(opacity) + A dx² + B dx dy
# + C dy². Up to MAX_CHANNELS channels begin at CHANNELS. RADIUS: on the screen, whole px. FIRST_X, FIRST_Y: first pixel
# of the box in which alpha ≥ 1/255.
U_, V_, A_, B_, C_, LOG2_OPACITY, OPACITY, CHANNELS = range(8)
RADIUS, FIRST_X, FIRST_Y, FLOATS = range(13, 17)
MAX_CHANNELS = RADIUS - CHANNELS
BOUNDS = 4  # floats of a row's bounds: mean and largest log scale
MAX_CAMERAS = 1024  # packed ones that are kept

Span = tuple[int, int]  # first, count
Triple = tuple[np.float32, np.float32, np.float32]


class Parameters(NamedTuple):
    """Rows of N Gaussians, `stride` floats each."""

    values: np.ndarray  # (N · stride,) float32; a cache line beyond may be read
    stride: int
    raw: bool  # before activation: scales are natural logarithms, opacities are logits


class Bounds(NamedTuple):
    """Bounds that culling tests: mean and largest deviation. The true ones may exceed them by a tolerance."""

    values: np.ndarray  # (N · BOUNDS,) float32: mean, and largest standard deviation, world units, or its logarithm
    raw: bool  # whether it is the natural logarithm
    tolerance: np.float32  # world units between a true mean and that of `values`
    growth: np.float32  # by how much the logarithm of a true deviation may exceed that of `values`


@dataclass(frozen=True)
class GaussianSource:
    """N Gaussians to render."""

    count: int
    parameters: Parameters
    bounds: Bounds
    stale: Stale = NO_STALE  # deferred steps, applied to candidates before their parameters are read


class PackedCamera(NamedTuple):
    """Pinhole camera with OpenCV axes (x right, y down, z forward); every number is float32.

    Pixel centres lie at whole numbers + 1/2.
    """

    x_axis: Triple  # rows of the world-to-camera rotation
    y_axis: Triple
    z_axis: Triple
    fx: np.float32  # px
    fy: np.float32
    cx: np.float32
    cy: np.float32
    centre: Triple  # world
    centre_rest: Triple  # what float32 leaves of the centre
    near: np.float32
    far: np.float32
    eps2d: np.float32  # px², added to the diagonal of the image covariance
    width: np.float32  # px
    height: np.float32


class Limits(NamedTuple):
    """Constants of `Blending`; the numbers are float32."""

    max_alpha: np.float32
    min_alpha: np.float32
    log2_min_alpha: np.float32
    min_transmittance: np.float32
    cutoff: np.float32  # σ: alpha is below min_alpha beyond it, whatever the opacity
    end_early: bool


class Columns(NamedTuple):
    """Columns of a row that are rendered: an opacity, and one or two colour sets, coefficients by channels each."""

    opacity: int
    first: int  # where each set begins
    second: int
    split: int  # channels of the first set
    used: int  # all that is rendered lies before


class Channels(NamedTuple):
    """Channels of a splat: `colors` of them, and with `depth` the camera-space z as one more."""

    colors: int
    degree: int  # of the spherical harmonics; −1: colours as they are
    depth: bool
    columns: Columns
    absgrad: bool = False  # two more numbers of a gradient slot: Σ |d/du| and Σ |d/dv| over pixels


class Settings(NamedTuple):
    """Camera, image size and options of a rendering."""

    camera: PackedCamera
    width: int  # px
    height: int
    channels: Channels
    background: np.ndarray  # (colours,) float32
    limits: Limits


class Projected(NamedTuple):
    """Gaussians in front of the camera."""

    gaussian_ids: np.ndarray  # (capacity,) int32, ascending
    radii: np.ndarray  # (capacity,) int32 px; 0: outside the image
    means2d: np.ndarray  # (capacity, 2) float32 px


class Splats(NamedTuple):
    """Projected Gaussians that cover some tile."""

    values: np.ndarray  # (capacity, 16) float32, columns as above
    gaussian_ids: np.ndarray  # (capacity,) int32, ascending
    pairs: np.ndarray  # (capacity, 2) int32: its first pair, and the last + 1
    depth_keys: np.ndarray  # (capacity,) uint32: bits of the camera-space z; only until the tiles are listed


class TileLists(NamedTuple):
    """The pairs of every tile, from near to far."""

    starts: np.ndarray  # (tiles + 1,) int64: first pair of each tile
    splat_ids: np.ndarray  # (pairs,) int32: row of Splats
    slots: np.ndarray  # (pairs,) int32: the pair's gradient slot


class Visits(NamedTuple):
    """Result of the blend that its gradient reuses."""

    counts: np.ndarray  # (tiles,) int32: pairs of a tile that were blended before it ended
    active_blocks: np.ndarray  # (pairs,) uint32: blocks in which a pair has weight; only of those counted


class ImageArrays(NamedTuple):
    """One camera's images, or the gradients of a loss with respect to them."""

    color: np.ndarray  # (H, W, colours) float32
    depth: np.ndarray  # (H, W) float32, or (0, 0)
    transmittance: np.ndarray  # (H, W) float32


class Slots(NamedTuple):
    """Gradient slots, one per pair."""

    values: np.ndarray  # (capacity · floats of a slot,) float32
    written: np.ndarray  # (capacity,) bool


class GradientArrays(NamedTuple):
    """Gradients of some Gaussians, a row each."""

    gaussian_ids: np.ndarray  # (capacity,) int32
    values: np.ndarray  # (capacity, columns) float32, columns as in `tdgbench.splats.gaussians`
    image: np.ndarray  # (capacity, 3 or 5) float32: d/du, d/dv per px, screen radius in px; Σ |d/du|, Σ |d/dv| per px


@dataclass
class ForwardPass:
    """Rendered images and the intermediate results that the backward pass needs."""

    images: ImageArrays
    projected: Projected
    projected_spans: list[Span]
    splats: Splats
    splat_spans: list[Span]
    tiles: TileLists
    visits: Visits
    pair_capacity: int  # every gradient slot lies below
    workspace: Workspace  # holds the arrays above


def source_of_arrays(arrays: Sequence[np.ndarray]) -> GaussianSource:
    """Return the source of means (N, 3), quats (N, 4), scales (N, 3), opacities (N,) and colors (N, …), activated."""
    parts = [array.reshape(len(array), math.prod(array.shape[1:])) for array in arrays]
    values, bounds = empty_rows(len(parts[0]), sum(part.shape[1] for part in parts)), empty_rows(len(parts[0]), BOUNDS)
    to_rows(parts, torch.from_numpy(parts[2]).amax(dim=1).numpy(), values, bounds)
    return source_of_rows(values, bounds, 0.0, 0.0, raw=False)


def source_of_rows(
    values: np.ndarray, bounds: np.ndarray, tolerance: float, growth: float, stale: Stale = NO_STALE, raw: bool = True
) -> GaussianSource:
    """Return the source of rows (N, columns), by default before activation.

    values: a cache line beyond them may be read, see `empty_rows`. bounds (N, 4): mean and largest scale (raw: its
    logarithm), each as of the last update of the bounds.
    """
    tested = Bounds(bounds.reshape(-1), raw, np.float32(tolerance), np.float32(growth))
    return GaussianSource(len(values), Parameters(values.reshape(-1), values.shape[1], raw), tested, stale)


def plain_channels(colors: int, degree: int, depth: bool, absgrad: bool = False) -> Channels:
    """Return the channels of rows with one opacity and one colour set."""
    used = COLORS_AT + colors * max((degree + 1) ** 2, 1)
    return Channels(colors, degree, depth, Columns(OPACITY_AT, COLORS_AT, COLORS_AT, colors, used), absgrad)


def pack_camera(viewmat, K, width: int, height: int, near_plane: float, far_plane: float, eps2d: float) -> PackedCamera:
    """Return the camera of viewmat (4, 4), world to camera, and K (3, 3), px; arrays or tensors on the CPU."""
    numbers = np.asarray(viewmat, np.float64).tobytes(), np.asarray(K, np.float64).tobytes()
    return _packed(*numbers, width, height, near_plane, far_plane, eps2d)


@functools.lru_cache(MAX_CAMERAS)
def _packed(viewmat: bytes, K: bytes, *others: float) -> PackedCamera:
    view, intrinsics = np.frombuffer(viewmat).reshape(4, 4), np.frombuffer(K).reshape(3, 3)
    width, height, near_plane, far_plane, eps2d = others
    axes = (_triple(row) for row in view[:3, :3])
    exact = np.linalg.solve(view[:3, :3], -view[:3, 3])
    centre = _triple(exact)
    intrinsics = map(np.float32, intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]])
    planes_and_size = map(np.float32, (near_plane, far_plane, eps2d, width, height))
    return PackedCamera(*axes, *intrinsics, centre, _triple(exact - np.array(centre)), *planes_and_size)


def _triple(values: np.ndarray) -> Triple:
    x, y, z = values.astype(np.float32)
    return x, y, z


@functools.lru_cache
def pack_limits(blending: Blending) -> Limits:
    """Return the limits of a blending. Raises ValueError where no cutoff exists.

    >>> limits = pack_limits(Blending())
    >>> float(limits.max_alpha), round(float(limits.cutoff), 3)
    (0.9900000095367432, 3.329)
    """
    if blending.min_alpha <= 0:
        raise ValueError("backend cpu needs min_alpha above 0; use 'reference'")
    cutoff = math.sqrt(2 * math.log(1 / blending.min_alpha))
    numbers = (
        blending.max_alpha, blending.min_alpha, math.log2(blending.min_alpha), blending.min_transmittance, cutoff,
    )  # fmt: skip
    return Limits(*map(np.float32, numbers), blending.end_early)
