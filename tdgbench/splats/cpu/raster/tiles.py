"""Tile lists: which 16×16 tiles a Gaussian covers, and for every tile its Gaussians from near to far.

The lists are filled in the order of the Gaussians, which are close to each other in memory as in the image, and each is
sorted by itself, by a stable radix sort of numbers that hold depth and position: it fits the cache, which the depths of
all Gaussians do not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.types import TileLists
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.memory import take_next

F, U = np.float32, np.uint64
TILE = 16
PAIRS_EACH = 32_768  # that are worth a thread
ZERO, HALF, FOUR = F(0), F(0.5), F(4)
LOG2_E = F(math.log2(math.e))
SLACK = F(0.01)  # px by which boxes are widened against rounding; the blend decides on alpha itself
DIGIT_BITS = 8
DIGITS = 1 << DIGIT_BITS
PASSES = 32 // DIGIT_BITS
SHORT = 24  # a list up to this length is sorted by insertion
UPPER = U(32)  # first bit of the upper half of a number
LOWER = (U(1) << UPPER) - U(1)  # bits of its lower half


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
        items=total, each=PAIRS_EACH,
    )  # fmt: skip
    near_to_far = (workspace.take(role, total, np.int32) for role in ("splat ids", "slots of pairs"))
    out = TileLists(starts, *near_to_far)
    sort_tiles(pairs, found.splats.depth_keys, longest, out)
    return out


def sort_tiles(pairs: np.ndarray, depth_keys: np.ndarray, longest: int, out: TileLists) -> None:
    """Write the pairs of each tile, at most `longest`, from near to far to `out`, which has their starts; stably.

    pairs (n,) uint64, tile by tile: slot and, in the lower half, splat. depth_keys (capacity,) uint32, of each splat.
    """
    threads = pool.threads_for(len(pairs), PAIRS_EACH)
    pool.run(sort_lists, [(np.zeros(1, np.int64), longest, pairs, depth_keys, out)] * threads)


@kernel()
def sort_lists(counter, longest, pairs, depth_keys, out):
    """Sort the tiles that counter (1,) hands out, until none remains; the other arguments are those of `sort_tiles`."""
    numbers, spare = np.empty(longest, np.uint64), np.empty(longest, np.uint64)
    histograms, starts = np.zeros((PASSES, DIGITS), np.int32), out.starts
    while True:
        tile = take_next(counter)
        if tile >= starts.shape[0] - 1:
            break
        begin, count = starts[tile], starts[tile + 1] - starts[tile]
        bits = write_numbers(pairs, depth_keys, begin, count, numbers)
        is_in_spare = False
        if count <= SHORT:
            insert(numbers, count)
        else:
            passes = (bits + DIGIT_BITS - 1) // DIGIT_BITS
            count_digits(numbers, count, passes, histograms)
            for digit in range(passes):
                if is_in_spare:
                    move_by_digit(spare, count, digit, histograms, numbers)
                else:
                    move_by_digit(numbers, count, digit, histograms, spare)
                is_in_spare = not is_in_spare
        if is_in_spare:
            write_sorted(spare, begin, count, pairs, out)
        else:
            write_sorted(numbers, begin, count, pairs, out)


@kernel(inline=True)
def write_numbers(pairs, depth_keys, begin, count, numbers):
    """numbers[:count] = depth above the least, and position, of the pairs from `begin` on; returns a depth's bits."""
    least, most = LOWER, U(0)
    for i in range(U(count)):
        depth = U(depth_keys[pairs[U(begin) + i] & LOWER])
        numbers[i] = (depth << UPPER) | i
        least, most = min(least, depth), max(most, depth)
    for i in range(U(count)):
        numbers[i] -= least << UPPER
    bits = 0
    while count > 0 and (most - least) >> U(bits) != U(0):
        bits += 1
    return bits


@kernel(inline=True)
def insert(numbers, count):
    """Sort numbers[:count] by insertion."""
    for i in range(U(1), U(count)):
        number, place = numbers[i], i
        while place > U(0) and numbers[place - U(1)] > number:
            numbers[place] = numbers[place - U(1)]
            place -= U(1)
        numbers[place] = number


@kernel(inline=True)
def count_digits(numbers, count, passes, histograms):
    """histograms (PASSES, DIGITS) int32 = where the numbers of each digit begin, for the digits of the first passes."""
    for digit in range(passes):
        for value in range(U(DIGITS)):
            histograms[U(digit), value] = 0
    for i in range(U(count)):
        depth = numbers[i] >> UPPER
        for digit in range(U(passes)):
            histograms[digit, (depth >> (digit * U(DIGIT_BITS))) & U(DIGITS - 1)] += np.int32(1)
    for digit in range(U(passes)):
        total = np.int32(0)
        for value in range(U(DIGITS)):
            here = histograms[digit, value]
            histograms[digit, value] = total
            total += here


@kernel(inline=True)
def move_by_digit(numbers, count, digit, histograms, out):
    """out[:count] = the numbers in the order of a digit, stably; of the histograms, as counted, that of the digit is
    used up.
    """
    shift = UPPER + U(digit * DIGIT_BITS)
    for i in range(U(count)):
        number = numbers[i]
        value = (number >> shift) & U(DIGITS - 1)
        place = histograms[U(digit), value]
        out[U(place)] = number
        histograms[U(digit), value] = place + np.int32(1)


@kernel(inline=True)
def write_sorted(numbers, begin, count, pairs, out):
    """Write the pairs of a list in the order of its sorted numbers."""
    for i in range(U(count)):
        pair = pairs[U(begin) + (numbers[i] & LOWER)]
        out.splat_ids[U(begin) + i] = np.int32(pair & LOWER)
        out.slots[U(begin) + i] = np.int32(pair >> UPPER)
