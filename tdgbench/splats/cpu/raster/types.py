"""What the two passes hand from kernel to kernel.

Arrays are cut into spans (first, count), one per thread; the rows between spans are unused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu.raster.camera import Camera
from tdgbench.splats.cpu.raster.limits import Limits
from tdgbench.splats.cpu.raster.source import Span
from tdgbench.splats.cpu.scratch import Workspace


class Channels(NamedTuple):
    """What a splat's channels are: `colors` of them, and the camera-space z as one more with `depth`."""

    colors: int
    degree: int  # of the spherical harmonics; −1: colours as they are
    depth: bool

    def count_bases(self) -> int:
        """Coefficients per colour."""
        return (self.degree + 1) ** 2 if self.degree >= 0 else 1


@dataclass(frozen=True)
class Settings:
    """What a rendering needs besides Gaussians."""

    camera: Camera
    width: int  # px
    height: int
    degree: int  # −1: colours as they are
    depth_channel: bool
    background: np.ndarray  # (colours,) float32
    limits: Limits

    @property
    def channels(self) -> Channels:
        return Channels(len(self.background), self.degree, self.depth_channel)


class Projected(NamedTuple):
    """Gaussians in front of the camera."""

    gaussian_ids: np.ndarray  # (capacity,) int32, ascending
    radii: np.ndarray  # (capacity,) int32 px; 0: outside the image
    means2d: np.ndarray  # (capacity, 2) float32 px


class Splats(NamedTuple):
    """Projected Gaussians that cover some tile."""

    values: np.ndarray  # (capacity, 16) float32, columns as in `tdgbench.splats.cpu.raster.splat`
    gaussian_ids: np.ndarray  # (capacity,) int32, ascending
    pairs: np.ndarray  # (capacity, 2) int32: its first pair, and the last + 1
    depth_keys: np.ndarray  # (capacity,) uint32: bits of the camera-space z; only until the tiles are listed


class TileLists(NamedTuple):
    """The pairs of every tile, from near to far."""

    starts: np.ndarray  # (tiles + 1,) int64: first pair of each tile
    splat_ids: np.ndarray  # (pairs,) int32: row of Splats
    slots: np.ndarray  # (pairs,) int32: the pair's gradient slot


class Visits(NamedTuple):
    """What the blend found, for its gradient."""

    counts: np.ndarray  # (tiles,) int32: pairs of a tile that were blended before it ended
    active_blocks: np.ndarray  # (pairs,) uint32: blocks in which a pair has weight; only of those counted


class Images(NamedTuple):
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
    values: np.ndarray  # (capacity, columns) float32, columns as in `tdgbench.splats.columns`
    image: np.ndarray  # (capacity, 3) float32: d/du and d/dv per px, screen radius in px


@dataclass
class ForwardPass:
    """Images, and what the backward pass needs again."""

    images: Images
    projected: Projected
    projected_spans: list[Span]
    splats: Splats
    splat_spans: list[Span]
    tiles: TileLists
    visits: Visits
    pair_capacity: int  # every gradient slot lies below
    workspace: Workspace  # holds the arrays above

    def count_pairs(self) -> int:
        """Listed (tile, Gaussian) pairs."""
        return len(self.tiles.splat_ids)


@dataclass
class GradientRows:
    """Gradients of the Gaussians that some pixel depends on."""

    spans: list[Span]
    arrays: GradientArrays
    workspace: Workspace  # holds the arrays
