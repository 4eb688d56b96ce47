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
from tdgbench.splats.cpu.raster.sorting import Lists, sort_tiles
from tdgbench.splats.cpu.raster.types import TileLists
from tdgbench.splats.cpu.scratch import Workspace

F, U = np.float32, np.uint64
TILE = 16
COUNTED_EACH, LISTED_EACH = 500_000, 32_768  # pairs that are worth a thread
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
def list_box(box, tiles_x, n_pairs, tiles):
    """As `list_tiles`, every tile of a box."""
    for tile_y in range(box.top >> 4, (box.bottom >> 4) + 1):
        for tile_x in range(box.left >> 4, (box.right >> 4) + 1):
            if n_pairs < tiles.shape[0]:
                tiles[U(n_pairs)] = tile_y * tiles_x + tile_x
            n_pairs += 1
    return n_pairs


@kernel()
def list_tiles(ellipse, box, tiles_x, n_pairs, tiles):
    """Write the tiles (int64 scalars) that an ellipse covers behind the first n_pairs of `tiles` (capacity,) int32.

    Each row of tiles is cut to the ellipse's extent there: a box of 2×2 tiles or more has corners that the ellipse does
    not touch. Returns the new number of pairs; those beyond the capacity are counted, not written. tiles_x: tiles per
    row of the image.
    """
    capacity = tiles.shape[0]
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
            if n_pairs < capacity:
                tiles[U(n_pairs)] = tile_y * tiles_x + tile_x
            n_pairs += 1
    return n_pairs


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
def count_pairs(first, count, pair_tiles, counts):
    """counts (tiles,) int64 = pairs [first, first + count) in each tile; pair_tiles (capacity,) int32."""
    for tile in range(U(counts.shape[0])):
        counts[tile] = 0
    for pair in range(U(first), U(first + count)):
        counts[U(pair_tiles[pair])] += 1


@kernel()
def fill_lists(first, count, splats, pair_tiles, cursor, lists):
    """List the splats [first, first + count) where the cursor (tiles,) of each tile points.

    splats: Splats; pair_tiles (capacity,) int32; lists: Lists, written.
    """
    pairs, depth_keys = splats.pairs, splats.depth_keys
    keys, splat_ids, slots = lists.keys, lists.splat_ids, lists.slots
    for i in range(U(first), U(first + count)):
        for pair in range(pairs[i, U(0)], pairs[i, U(1)]):
            tile = U(pair_tiles[U(pair)])
            place = U(cursor[tile])
            cursor[tile] = int64(place) + 1
            keys[place] = depth_keys[i]
            splat_ids[place] = i
            slots[place] = pair


def list_by_tile(found, n_tiles: int, workspace: Workspace, scratch: Workspace) -> TileLists:
    """List every tile's pairs from near to far, of what projection `found`; equal depths keep the splats' order."""
    counts = np.empty((len(found.pair_spans), n_tiles), np.int64)
    pairs = sum(n for _, n in found.pair_spans)
    pool.run(
        count_pairs, [(*span, found.pair_tiles, c) for span, c in zip(found.pair_spans, counts)],
        items=pairs, each=COUNTED_EACH,
    )  # fmt: skip
    first, cursors = cursors_of(counts)
    starts = np.append(first, cursors[-1, -1] + counts[-1, -1])
    total = int(starts[-1])
    keys, splat_ids, slots = scratch.take("slots", (3, total), np.int32)  # memory that the backward pass needs later
    lists = Lists(keys.view(np.uint32), splat_ids, slots)
    pool.run(
        fill_lists, [(*span, found.splats, found.pair_tiles, c, lists) for span, c in zip(found.splat_spans, cursors)],
        items=pairs, each=LISTED_EACH,
    )  # fmt: skip
    near_to_far = (workspace.take(role, total, np.int32) for role in ("splat ids", "slots of pairs"))
    out = TileLists(starts, *near_to_far)
    sort_tiles(lists, out)
    return out


def cursors_of(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start of each bin (bins,), and of each piece's share of it (pieces, bins), given counts (pieces, bins).

    Pieces follow each other inside a bin.

    >>> starts, shares = cursors_of(np.array([[1, 2], [3, 0]]))
    >>> starts.tolist(), shares.tolist()
    ([0, 4], [[0, 4], [1, 6]])
    """
    ends = np.cumsum(counts.T).reshape(counts.shape[::-1]).T
    cursors = np.ascontiguousarray(ends - counts)
    return cursors[0].copy(), cursors
