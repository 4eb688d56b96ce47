"""CPU kernels of radiance fields: interpolation in a hash grid, its gradient, and the optimiser's step.

A thread has whole levels, or ranges of samples or entries. So no sum depends on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import load_anywhere, store_anywhere
from tdgbench.splats.cpu.simd.registers import LANES, any_bit, divide, is_nonzero, select, square_root

F, U = np.float32, np.uint32
FEATURES = 2  # of a row of a table, as in instant-ngp
PRIMES = (2654435761, 805459861)  # of the second and third coordinate; that of the first is 1 (Müller et al., eq. 4)


class Level(NamedTuple):
    """One grid of a hash grid; the row of a corner (x, y, z) is that of x, y · step_y and z · step_z."""

    cells: int  # along each axis
    rows: int  # of its table
    first: int  # of these rows in the table of all levels
    is_dense: bool  # every corner has a row, the sum; else a hash, their bits' exclusive or, chooses it
    step_y: int
    step_z: int


@kernel(inline=True)
def cell_of(coordinate, level):
    """Cell of a coordinate in [0, 1] along an axis, and the share of the way through it."""
    scaled = coordinate * F(level.cells)
    cell = min(U(np.int32(scaled)), U(level.cells - 1))  # NaN and numbers out of range become cells, too
    return cell, scaled - F(np.int32(cell))


@kernel(inline=True)
def row_of(level, x, y, z):
    """Row of a corner in the table of all levels, given its coordinates times their steps."""
    return U(level.first) + (x + y + z if level.is_dense else (x ^ y ^ z) & U(level.rows - 1))


@kernel(inline=True)
def corners_of(positions, n, level):
    """Rows and weights of the eight corners around a position, x first."""
    x, u = cell_of(positions[n, 0], level)
    y, v = cell_of(positions[n, 1], level)
    z, w = cell_of(positions[n, 2], level)
    y *= U(level.step_y)
    z *= U(level.step_z)
    right, below, behind = x + U(1), y + U(level.step_y), z + U(level.step_z)
    rest_u, rest_v, rest_w = F(1) - u, F(1) - v, F(1) - w
    a, b, c, d = rest_v * rest_w, v * rest_w, rest_v * w, v * w
    rows = (
        row_of(level, x, y, z), row_of(level, right, y, z), row_of(level, x, below, z), row_of(level, right, below, z),
        row_of(level, x, y, behind), row_of(level, right, y, behind),
        row_of(level, x, below, behind), row_of(level, right, below, behind),
    )  # fmt: skip
    return rows, (rest_u * a, u * a, rest_u * b, u * b, rest_u * c, u * c, rest_u * d, u * d)


@kernel()
def encode_level(start, stop, positions, level, table, out):
    """out[f, n] = Σ over the corners of weight × table[row, f], for samples [start, stop).

    positions (N, 3) in [0, 1], table (rows, FEATURES), out (FEATURES, N): float32.
    """
    for n in range(start, stop):
        rows, weights = corners_of(positions, n, level)
        first, second = F(0), F(0)
        for c in range(8):
            first += weights[c] * table[rows[c], 0]
            second += weights[c] * table[rows[c], 1]
        out[0, n] = first
        out[1, n] = second


@kernel()
def add_gradients(positions, level, gradients, table_gradients):
    """Add the gradients of what `encode_level` gave, (FEATURES, N), to those of the table, sample after sample."""
    for n in range(len(positions)):
        rows, weights = corners_of(positions, n, level)
        first, second = gradients[0, n], gradients[1, n]
        for c in range(8):
            table_gradients[rows[c], 0] += weights[c] * first
            table_gradients[rows[c], 1] += weights[c] * second


@kernel()
def step_entries(start, stop, values, gradients, first, second, constants):
    """Step the entries [start, stop), a multiple of LANES, whose gradient is not 0. Arrays: (N,) float32.

    constants: beta1, 1 − beta1, beta2, 1 − beta2, rate / (1 − beta1^t), 1 / √(1 − beta2^t), eps. A register of entries
    without gradients is left out before its moments are read.
    """
    beta1, rest1, beta2, rest2, step_size, per_bias2, eps = constants
    for i in range(start, stop, LANES):
        g = load_anywhere(gradients, i)
        if any_bit(g):
            changes = is_nonzero(g)
            p, old_m, old_v = load_anywhere(values, i), load_anywhere(first, i), load_anywhere(second, i)
            m = old_m * beta1 + g * rest1
            v = old_v * beta2 + g * g * rest2
            moved = p - divide(m, square_root(v) * per_bias2 + eps) * step_size
            store_anywhere(first, i, select(changes, m, old_m))
            store_anywhere(second, i, select(changes, v, old_v))
            store_anywhere(values, i, select(changes, moved, p))
