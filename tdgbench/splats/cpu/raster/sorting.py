"""Sorting of the pairs of each tile by depth, stably: a radix sort of numbers that hold depth and position."""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.types import TileLists
from tdgbench.splats.cpu.simd.memory import take_next

U = np.uint64
DIGIT_BITS = 8
DIGITS = 1 << DIGIT_BITS
PASSES = 32 // DIGIT_BITS
PAIRS_EACH = 32_768  # that are worth a thread
SHORT = 24  # a list up to this length is sorted by insertion
UPPER = U(32)  # first bit of the upper half of a number
LOWER = (U(1) << UPPER) - U(1)  # bits of its lower half


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
