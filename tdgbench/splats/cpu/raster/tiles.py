"""Tile lists: which 16×16 tiles a Gaussian covers, and for every tile its Gaussians from near to far.

No list of pairs is sorted: N depths are, and the lists are filled in that order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.sorting import cursors_of
from tdgbench.splats.cpu.simd.memory import prefetch, prefetch_row

F, U = np.float32, np.uint64
TILE = 16
ZERO, HALF, FOUR = F(0), F(0.5), F(4)
LOG2_E = F(math.log2(math.e))
SLACK = F(0.01)  # px by which boxes are widened against rounding; the blend decides on alpha itself
PREFETCH_DISTANCE, FAR_PREFETCH_DISTANCE = 8, 16  # splats


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


class Box(NamedTuple):
    """First and last column and row of pixels."""

    left: int
    right: int
    top: int
    bottom: int


@kernel()
def list_tiles(ellipse, box, loose, tiles_x, n_pairs, tiles):
    """Write the tiles (int64 scalars) that an ellipse covers behind the first n_pairs of `tiles` (capacity,) int32.

    Returns the new number of pairs; those beyond the capacity are counted, not written. loose: every tile of the box.
    tiles_x: tiles per row of the image.
    """
    capacity = tiles.shape[0]
    # A box of 2×2 tiles or more has corners that the ellipse does not touch: cut each row of tiles to the ellipse's
    # extent there.
    has_corners = not loose and (box.right >> 4) > (box.left >> 4) and (box.bottom >> 4) > (box.top >> 4)
    for tile_y in range(box.top >> 4, (box.bottom >> 4) + 1):
        first, last = box.left, box.right
        if has_corners:
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


@kernel(inline=True)
def prefetch_next(order, k, last, pairs, pair_tiles):
    """Prefetch what the splats after the k-th need."""
    prefetch_row(pairs, U(order[min(k + U(FAR_PREFETCH_DISTANCE), last)]))
    prefetch(pair_tiles, U(pairs[U(order[min(k + U(PREFETCH_DISTANCE), last)]), U(0)]))


@kernel()
def count_pairs(start, stop, order, pairs, pair_tiles, counts):
    """counts (tiles,) int64 = pairs of the splats order[start:stop] in each tile.

    order (splats,) int32; pairs (capacity, 2) int32: first pair of each splat, and the last + 1; pair_tiles (pairs,).
    """
    for tile in range(U(counts.shape[0])):
        counts[tile] = 0
    last = U(order.shape[0] - 1)
    for k in range(U(start), U(stop)):
        prefetch_next(order, k, last, pairs, pair_tiles)
        i = U(order[k])
        for pair in range(pairs[i, U(0)], pairs[i, U(1)]):
            counts[U(pair_tiles[U(pair)])] += 1


@kernel()
def fill_lists(start, stop, order, pairs, pair_tiles, cursor, splat_ids, slots):
    """List the splats order[start:stop] where the cursor (tiles,) of each tile points; arguments as above.

    splat_ids and slots (pairs,) int32, written: each pair's splat and its number before sorting, its gradient slot.
    """
    last = U(order.shape[0] - 1)
    for k in range(U(start), U(stop)):
        prefetch_next(order, k, last, pairs, pair_tiles)
        i = U(order[k])
        for pair in range(pairs[i, U(0)], pairs[i, U(1)]):
            tile = U(pair_tiles[U(pair)])
            place = U(cursor[tile])
            cursor[tile] = int64(place) + 1
            splat_ids[place] = i
            slots[place] = pair


def list_by_tile(order: np.ndarray, pairs: np.ndarray, pair_tiles: np.ndarray, n_tiles: int, take):
    """starts (tiles + 1,) int64, splat_ids and slots (pairs,) int32: every tile's splats, in the order given.

    order (splats,) int32; pairs (capacity, 2) int32; pair_tiles (capacity,) int32; take(role, size, dtype)
    gives memory.
    """
    pieces = pool.chunks(len(order), max(1, min(pool.get_threads(), len(order))))
    counts = np.empty((len(pieces), n_tiles), np.int64)
    pool.run(count_pairs, [(*p, order, pairs, pair_tiles, c) for p, c in zip(pieces, counts)])
    first, cursors = cursors_of(counts)
    starts = np.append(first, cursors[-1, -1] + counts[-1, -1])
    splat_ids, slots = (take(role, int(starts[-1]), np.int32) for role in ("splat ids", "slots of pairs"))
    pool.run(fill_lists, [(*p, order, pairs, pair_tiles, c, splat_ids, slots) for p, c in zip(pieces, cursors)])
    return starts, splat_ids, slots
