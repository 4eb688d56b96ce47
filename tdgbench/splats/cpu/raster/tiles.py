"""Tile lists: which 16×16 tiles a Gaussian reaches, and for every tile its Gaussians from near to far.

No list of pairs is sorted: N depths are, and the lists are filled in that order.
"""

from __future__ import annotations

import math

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import prefetch, prefetch_row

F, U = np.float32, np.uint64
TILE = 16
ZERO, HALF, FOUR = F(0), F(0.5), F(4)
LOG2_E = F(math.log2(math.e))
SLACK = F(0.01)  # px by which boxes are widened against rounding; the blend decides on alpha itself
DIGIT_BITS = 11
AHEAD, FAR_AHEAD = 8, 16  # records for which memory is asked before they are listed
ALONE_BELOW = 20_000  # Gaussians that one thread sorts faster than several


@kernel()
def list_tiles(n_pairs, u, v, A, B, C, det, cut, hw, hh, slope, x0, x1, y0, y1, loose, tiles_x, tile_of_pair):
    """Write the tiles that a Gaussian reaches behind the first n_pairs; returns how many there are then.

    Pairs beyond the room in `tile_of_pair` are counted but not written. The box's half sides are hw, hh; cut is by how
    much log2(opacity) is above log2(min_alpha); slope = b / a · hw is the ordinate of the ellipse's right end.
    loose: every tile of the box.
    """
    room = tile_of_pair.shape[0]
    # Where the box spans 2×2 tiles or more it has corners that the ellipse does not reach: cut each row of tiles
    # to the ellipse's own extent there. Roots of A dx² + B dy dx + C dy² = −cut; B² − 4AC = −log2(e)²/det.
    has_corners = not loose and (x1 >> 4) > (x0 >> 4) and (y1 >> 4) > (y0 >> 4)
    discriminant, per_2a = -LOG2_E * LOG2_E / det, HALF / A
    for tile_y in range(y0 >> 4, (y1 >> 4) + 1):
        first, last = x0, x1
        if has_corners:
            upper = max(F(tile_y * TILE) + HALF - v, -hh)
            lower = min(F(tile_y * TILE + TILE - 1) + HALF - v, hh)
            root_u = math.sqrt(max(discriminant * upper * upper - FOUR * A * cut, ZERO))
            root_l = math.sqrt(max(discriminant * lower * lower - FOUR * A * cut, ZERO))
            if slope >= upper and slope <= lower:
                reach_right = hw
            else:
                reach_right = max((-B * upper - root_u) * per_2a, (-B * lower - root_l) * per_2a)
            if -slope >= upper and -slope <= lower:
                reach_left = -hw
            else:
                reach_left = min((-B * upper + root_u) * per_2a, (-B * lower + root_l) * per_2a)
            begin = max(u + reach_left - HALF - SLACK, F(x0))
            end = min(u + reach_right - HALF + SLACK, F(x1))
            if not (end >= begin):
                continue
            first, last = int64(math.ceil(begin)), int64(end)
            if last < first:
                continue
        for tile_x in range(first >> 4, (last >> 4) + 1):
            tile = tile_y * tiles_x + tile_x
            if n_pairs < room:
                tile_of_pair[U(n_pairs)] = tile
            n_pairs += 1
    return n_pairs


@kernel()
def count_digits(start, stop, keys, lowest, shift, histogram):
    """How often each digit occurs among keys [start, stop)."""
    mask = histogram.shape[0] - 1
    for digit in range(U(histogram.shape[0])):
        histogram[digit] = 0
    for i in range(U(start), U(stop)):
        histogram[((keys[i] - lowest) >> shift) & mask] += 1


@kernel()
def move_by_digit(start, stop, keys, values, lowest, shift, cursor, out_keys, out_values):
    """Put keys [start, stop) and their values where the cursor of their digit points."""
    mask = cursor.shape[0] - 1
    for i in range(U(start), U(stop)):
        digit = U(((keys[i] - lowest) >> shift) & mask)
        place = U(cursor[digit])
        cursor[digit] = int64(place) + 1
        out_keys[place] = keys[i]
        out_values[place] = values[i]


def sort_by_key(pieces, keys, values, spare):
    """Sort uint32 keys stably with their int32 values: a radix sort that all threads share.

    The input is in `pieces` (start, stop) of keys and values; spare is two more pairs of arrays to work in. Returns the
    sorted keys and values, packed at the beginning of one of those pairs.
    """
    count = sum(stop - start for start, stop in pieces)
    pieces = [piece for piece in pieces if piece[1] > piece[0]]
    if not pieces:
        return spare[0][0][:0], spare[0][1][:0]
    lowest = min(keys[a:b].min() for a, b in pieces)
    highest = max(keys[a:b].max() for a, b in pieces)
    bits = max(1, int(highest - lowest).bit_length())
    passes = -(-bits // DIGIT_BITS)
    width = -(-bits // passes)
    source, targets = (keys, values), list(spare)
    for digit in range(passes):
        if digit > 0:
            pieces = pool.chunks(count, 1 if count < ALONE_BELOW else pool.get_threads())
        histograms = np.empty((len(pieces), 1 << width), np.int64)
        shift = np.uint32(width * digit)
        pool.run(count_digits, [(*p, source[0], lowest, shift, h) for p, h in zip(pieces, histograms)])
        _, cursors = _cursors(histograms)
        target = targets[digit % 2]
        pool.run(move_by_digit, [(*p, *source, lowest, shift, c, *target) for p, c in zip(pieces, cursors)])
        source = target
    return source[0][:count], source[1][:count]


@kernel(inline=True)
def look_ahead(order, k, last, pairs, tile_of_pair):
    """Ask for the memory of the records that come after the k-th."""
    prefetch_row(pairs, U(order[min(k + U(FAR_AHEAD), last)]))
    prefetch(tile_of_pair, U(pairs[U(order[min(k + U(AHEAD), last)]), U(0)]))


@kernel()
def count_pairs(start, stop, order, pairs, tile_of_pair, counts):
    """counts[tile] = pairs of the records order[start:stop]."""
    for tile in range(U(counts.shape[0])):
        counts[tile] = 0
    last = U(order.shape[0] - 1)
    for k in range(U(start), U(stop)):
        look_ahead(order, k, last, pairs, tile_of_pair)
        i = U(order[k])
        for pair in range(pairs[i, U(0)], pairs[i, U(1)]):
            counts[U(tile_of_pair[U(pair)])] += 1


@kernel()
def fill_lists(start, stop, order, pairs, tile_of_pair, cursor, gaussian_of, slot_of):
    """List the records order[start:stop] where the cursor of each tile points; slot_of: each pair's own slot."""
    last = U(order.shape[0] - 1)
    for k in range(U(start), U(stop)):
        look_ahead(order, k, last, pairs, tile_of_pair)
        i = U(order[k])
        for pair in range(pairs[i, U(0)], pairs[i, U(1)]):
            tile = U(tile_of_pair[U(pair)])
            place = U(cursor[tile])
            cursor[tile] = int64(place) + 1
            gaussian_of[place] = i
            slot_of[place] = pair


def list_by_tile(order, pairs, tile_of_pair, n_tiles: int, take):
    """tile_start (tiles + 1,), and for every tile its records and their slots, in the given order of records.

    take(role, size, dtype) gives memory.
    """
    pieces = pool.chunks(len(order), max(1, min(pool.get_threads(), len(order))))
    counts = np.empty((len(pieces), n_tiles), np.int64)
    pool.run(count_pairs, [(*p, order, pairs, tile_of_pair, c) for p, c in zip(pieces, counts)])
    starts, cursors = _cursors(counts)
    tile_start = np.append(starts, cursors[-1, -1] + counts[-1, -1])
    gaussian_of, slot_of = (take(role, int(tile_start[-1]), np.int32) for role in ("gaussian of", "slot of"))
    lists = (gaussian_of, slot_of)
    pool.run(fill_lists, [(*p, order, pairs, tile_of_pair, c, *lists) for p, c in zip(pieces, cursors)])
    return tile_start, *lists


def _cursors(counts):
    """Where each bin begins, and where each piece's share of it does: pieces follow each other inside a bin."""
    ends = np.cumsum(counts.T).reshape(counts.shape[::-1]).T
    cursors = np.ascontiguousarray(ends - counts)
    return cursors[0].copy(), cursors
