"""Tile lists: which 16×16 tiles a Gaussian covers, and for every tile its Gaussians from near to far.

The lists are filled in the order of the Gaussians, which are close to each other in memory as in the image, and each is
sorted by itself: it fits the cache, which the depths of all Gaussians do not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.sorting import UPPER, sort_tiles
from tdgbench.splats.cpu.raster.types import TileLists
from tdgbench.splats.cpu.scratch import Workspace

F, U = np.float32, np.uint64
TILE = 16
LISTED_EACH = 32_768  # pairs that are worth a thread
ZERO, HALF, FOUR = F(0), F(0.5), F(4)
LOG2_E = F(math.log2(math.e))
SLACK = F(0.01)  # px by which boxes are widened against rounding; the blend decides on alpha itself


class Ellipse(NamedTuple):
    """Where alpha ≥ min_alpha: A dx² + B dy dx + C dy² ≥ −cut, with (dx, dy) from the mean (u, v), px; scalars."""

    u: float
    v: float
    A: float
    B: float
    C: float
    det: float  # of the image covariance, px⁴
    cut: float  # log2(opacity) − log2(min_alpha)
    half_width: float  # of the box around it, px
    half_height: float
    slope: float  # dy of its rightmost point, px


class PixelBox(NamedTuple):
    """First and last column and row of pixels."""

    left: int
    right: int
    top: int
    bottom: int


@kernel(inline=True)
def list_box(box, tiles_x, n_pairs, tiles, counts):
    """As `list_tiles`, every tile of a box."""
    for tile_y in range(box.top >> 4, (box.bottom >> 4) + 1):
        for tile_x in range(box.left >> 4, (box.right >> 4) + 1):
            n_pairs = add_pair(tile_y * tiles_x + tile_x, n_pairs, tiles, counts)
    return n_pairs


@kernel()
def list_tiles(ellipse, box, tiles_x, n_pairs, tiles, counts):
    """Write the tiles (int64 scalars) that an ellipse covers behind the first n_pairs of `tiles` (capacity,) int32.

    Each row of tiles is cut to the ellipse's extent there: a box of 2×2 tiles or more has corners that the ellipse does
    not touch. Returns the new number of pairs; those beyond the capacity are not written. counts (tiles,) int64: of the
    pairs of each tile. tiles_x: tiles per row of the image.
    """
    for tile_y in range(box.top >> 4, (box.bottom >> 4) + 1):
        left, right = extent_in_rows(ellipse, tile_y)
        begin = max(ellipse.u + left - HALF - SLACK, F(box.left))
        end = min(ellipse.u + right - HALF + SLACK, F(box.right))
        if not (end >= begin):
            continue
        first, last = int64(math.ceil(begin)), int64(end)
        if last < first:
            continue
        for tile_x in range(first >> 4, (last >> 4) + 1):
            n_pairs = add_pair(tile_y * tiles_x + tile_x, n_pairs, tiles, counts)
    return n_pairs


@kernel(inline=True)
def add_pair(tile, n_pairs, tiles, counts):
    """Add a pair to those of a tile."""
    if n_pairs < tiles.shape[0]:
        tiles[U(n_pairs)] = tile
    counts[U(tile)] += 1
    return n_pairs + 1


@kernel(inline=True)
def extent_in_rows(ellipse, tile_y):
    """Left and right end (dx, px) of an ellipse within a row of tiles.

    Roots of A dx² + B dy dx + C dy² = −cut; B² − 4AC = −log2(e)²/det.
    """
    A, B, slope = ellipse.A, ellipse.B, ellipse.slope
    discriminant, per_2a = -LOG2_E * LOG2_E / ellipse.det, HALF / A
    upper = max(F(tile_y * TILE) + HALF - ellipse.v, -ellipse.half_height)
    lower = min(F(tile_y * TILE + TILE - 1) + HALF - ellipse.v, ellipse.half_height)
    root_u = math.sqrt(max(discriminant * upper * upper - FOUR * A * ellipse.cut, ZERO))
    root_l = math.sqrt(max(discriminant * lower * lower - FOUR * A * ellipse.cut, ZERO))
    if slope >= upper and slope <= lower:
        right = ellipse.half_width
    else:
        right = max((-B * upper - root_u) * per_2a, (-B * lower - root_l) * per_2a)
    if -slope >= upper and -slope <= lower:
        left = -ellipse.half_width
    else:
        left = min((-B * upper + root_u) * per_2a, (-B * lower + root_l) * per_2a)
    return left, right


@kernel()
def start_lists(counts, starts):
    """starts (tiles + 1,) = first pair of each tile, and counts (pieces, tiles) = that of each piece's share of it.

    Both are int64; counts, as given, are of pairs. Pieces follow each other inside a tile. Returns the largest number
    of pairs of a tile.
    """
    total, longest = int64(0), int64(0)
    for tile in range(U(counts.shape[1])):
        starts[tile] = total
        for piece in range(U(counts.shape[0])):
            here = counts[piece, tile]
            counts[piece, tile] = total
            total += here
        longest = max(longest, total - starts[tile])
    starts[U(counts.shape[1])] = total
    return longest


@kernel()
def fill_lists(first, count, splats, pair_tiles, cursor, pairs):
    """List the splats [first, first + count) where the cursor (tiles,) of each tile points.

    splats: Splats; pair_tiles (capacity,) int32; pairs (n,) uint64, written as `sort_tiles` takes them.
    """
    spans = splats.pairs
    for i in range(U(first), U(first + count)):
        for slot in range(U(spans[i, U(0)]), U(spans[i, U(1)])):
            tile = U(pair_tiles[slot])
            place = U(cursor[tile])
            cursor[tile] = int64(place) + 1
            pairs[place] = (slot << UPPER) | i


def list_by_tile(found, workspace: Workspace, scratch: Workspace) -> TileLists:
    """List every tile's pairs of a projection from near to far; splats of equal depth keep their order."""
    cursors, total = found.tile_counts, sum(n for _, n in found.pair_spans)
    starts = np.empty(cursors.shape[1] + 1, np.int64)
    longest = start_lists(cursors, starts)
    pairs = scratch.take("slots", total, np.uint64)  # memory that the backward pass needs later
    pool.run(
        fill_lists, [(*span, found.splats, found.pair_tiles, c, pairs) for span, c in zip(found.splat_spans, cursors)],
        items=total, each=LISTED_EACH,
    )  # fmt: skip
    near_to_far = (workspace.take(role, total, np.int32) for role in ("splat ids", "slots of pairs"))
    out = TileLists(starts, *near_to_far)
    sort_tiles(pairs, found.splats.depth_keys, longest, out)
    return out
