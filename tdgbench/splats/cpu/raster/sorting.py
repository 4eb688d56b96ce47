"""Stable radix sort of splats by depth, on several threads."""

from __future__ import annotations

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

U = np.uint64
DIGIT_BITS = 11
ONE_THREAD_BELOW = 20_000  # keys that one thread sorts faster than several


@kernel()
def count_digits(start, stop, keys, lowest, shift, histogram):
    """histogram (digits,) int64 = how often each digit occurs among keys [start, stop), uint32 (n,)."""
    mask = histogram.shape[0] - 1
    for digit in range(U(histogram.shape[0])):
        histogram[digit] = 0
    for i in range(U(start), U(stop)):
        histogram[((keys[i] - lowest) >> shift) & mask] += 1


@kernel()
def move_by_digit(start, stop, keys, values, lowest, shift, cursor, out_keys, out_values):
    """Put keys [start, stop), uint32 (n,), and their int32 values where the cursor (digits,) of their digit points."""
    mask = cursor.shape[0] - 1
    for i in range(U(start), U(stop)):
        digit = U(((keys[i] - lowest) >> shift) & mask)
        place = U(cursor[digit])
        cursor[digit] = int64(place) + 1
        out_keys[place] = keys[i]
        out_values[place] = values[i]


def sort_by_key(pieces, keys, values, spare):
    """Sort uint32 keys (capacity,) stably with their int32 values (capacity,): a radix sort that all threads share.

    The input lies in `pieces` (start, stop) of keys and values; spare is two more pairs of such arrays, for scratch.
    Returns the sorted keys and values, packed at the beginning of one of those pairs.
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
            pieces = pool.chunks(count, 1 if count < ONE_THREAD_BELOW else pool.get_threads())
        histograms = np.empty((len(pieces), 1 << width), np.int64)
        shift = np.uint32(width * digit)
        pool.run(count_digits, [(*p, source[0], lowest, shift, h) for p, h in zip(pieces, histograms)])
        _, cursors = cursors_of(histograms)
        target = targets[digit % 2]
        pool.run(move_by_digit, [(*p, *source, lowest, shift, c, *target) for p, c in zip(pieces, cursors)])
        source = target
    return source[0][:count], source[1][:count]


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
