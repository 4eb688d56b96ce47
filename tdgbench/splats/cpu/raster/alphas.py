"""Alpha of a Gaussian in the blocks of a tile, and in which blocks it may count."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster import types as splat
from tdgbench.splats.cpu.raster.blocks import ACROSS, BLOCKS, HEIGHT, NONE, WIDTH, Y
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    absolute,
    broadcast,
    exp2_by,
    greater_equal,
    lane_bits,
    lowest,
    minimum,
    select,
)

F, U = np.float32, np.uint64
DX, DX_B, ALONG_X, COLUMN = U(0), U(LANES), U(2 * LANES), U(4 * LANES)  # of a column of blocks; its floats
HALF_WIDTH, HALF_HEIGHT = F((WIDTH - 1) / 2), F((HEIGHT - 1) / 2)  # from a block's centre to its outermost pixels'
ZERO, TWO = F(0), F(2)
ROUNDING = F(1 / 64)  # bound of the rounding error of log2(alpha)


class Form(NamedTuple):
    """log2(alpha) = log2_opacity + A dx² + B dx dy + C dy², registers; (dx, dy) leads from the mean to the tile, px."""

    dx: float
    dy: float
    A: float
    B: float
    C: float
    log2_opacity: float


@kernel(inline=True)
def form_of(splats, i, tile):
    """Form of row i of splats (n, 16), relative to a tile."""
    return Form(
        broadcast((F(tile.left) - splats[i, splat.FIRST_X]) - splats[i, splat.U_]),
        broadcast((F(tile.top) - splats[i, splat.FIRST_Y]) - splats[i, splat.V_]),
        broadcast(splats[i, splat.A_]),
        broadcast(splats[i, splat.B_]),
        broadcast(splats[i, splat.C_]),
        broadcast(splats[i, splat.LOG2_OPACITY]),
    )


@kernel(inline=True)
def write_columns(columns, form, centres):
    """Write what the blocks of a column share: dx, dx B and log2_opacity + A dx²."""
    for column in range(U(ACROSS)):
        dx = load(centres, U(2 * BLOCKS) + column * U(2 * LANES)) + form.dx
        store(columns, column * COLUMN + DX, dx)
        store(columns, column * COLUMN + DX_B, dx * form.B)
        store(columns, column * COLUMN + ALONG_X, dx * dx * form.A + form.log2_opacity)


@kernel(inline=True)
def write_alphas(alphas, pixels, size, columns, form, blocks, limits, powers):
    """alphas[LANES block …] = alpha in each of `blocks`, zero below min_alpha."""
    while blocks != NONE:
        block = lowest(blocks)
        blocks &= blocks - U(1)
        column = (block & U(ACROSS - 1)) * COLUMN
        dy = load(pixels, block * U(size) + Y) + form.dy
        log2_alpha = dy * (dy * form.C + load(columns, column + DX_B)) + load(columns, column + ALONG_X)
        alpha = minimum(exp2_in_memory(log2_alpha, powers), limits.max_alpha)
        store(
            alphas,
            block * U(LANES),
            select(greater_equal(log2_alpha, limits.log2_min_alpha), alpha, broadcast(ZERO)),
        )


@kernel(inline=True)
def active_blocks(centres, form, log2_min_alpha):
    """Blocks in which log2(alpha) may be log2_min_alpha or more.

    It is concave, so it lies below its tangent plane at the block's centre: below the value there and |slope| times the
    distance to the outermost pixels.
    """
    dx = load(centres, 0) + form.dx  # all registers of blocks have the same columns
    a, b = dx * form.A, dx * form.B
    along_x = dx * a + form.log2_opacity
    least = log2_min_alpha - ROUNDING
    blocks = NONE
    for first in range(0, BLOCKS, LANES):
        dy = load(centres, BLOCKS + first) + form.dy
        c = dy * form.C
        middle = dy * (c + b) + along_x
        slope_x, slope_y = a * TWO + dy * form.B, c * TWO + b
        highest = middle + absolute(slope_x) * HALF_WIDTH + absolute(slope_y) * HALF_HEIGHT
        blocks |= lane_bits(greater_equal(highest, broadcast(least))) << U(first)
    return blocks


@kernel(inline=True)
def exp2_in_memory(x, table):
    """2^x to 2.5e-7 relative for a register x, |x| < 126; table: `BlockTables.powers`."""
    first = (load(table, 0), load(table, LANES), load(table, 2 * LANES))
    return exp2_by(x, *first, load(table, 3 * LANES), load(table, 4 * LANES), load(table, 5 * LANES))
