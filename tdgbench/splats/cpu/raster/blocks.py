"""How a tile's pixels lie in registers: blocks of 4 × LANES / 4 pixels, numbered row by row from the tile's corner.

A small Gaussian touches fewer blocks than it would touch strips of one row. A set of blocks is a number, one bit each.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.records import A_, B_, C_, FIRST_X, FIRST_Y, LOG2_OPACITY, U_, V_
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.reductions import lane_bits
from tdgbench.splats.cpu.simd.registers import LANES, absolute, greater, greater_equal, select, splat

F, U = np.float32, np.uint64
WIDTH, HEIGHT = 4, LANES // 4  # of a block, px
ACROSS, DOWN = TILE // WIDTH, TILE // HEIGHT
BLOCKS = ACROSS * DOWN
X, Y, T, OWN = U(0), U(LANES), U(2 * LANES), U(3 * LANES)  # a block's values: centres, transmittance, a kernel's own
ALL, NONE = U(2**BLOCKS - 1), U(0)
HALF_WIDTH, HALF_HEIGHT = F((WIDTH - 1) / 2), F((HEIGHT - 1) / 2)  # from a block's centre to its outermost pixels'
TWO, DEAD = F(2), F(-0.0)
ROUNDING = F(1 / 64)  # by which log2(alpha) may be off


@intrinsic
def lowest(typing_context, blocks):
    """The number of the first block of a set that is not empty."""

    def generate(context, builder, signature, args):
        long, bit = ir.IntType(64), ir.IntType(1)
        name = "llvm.cttz.i64"
        known = builder.module.globals.get(name)
        function = known or ir.Function(builder.module, ir.FunctionType(long, [long, bit]), name)
        return builder.call(function, [args[0], bit(1)])

    return types.uint64(types.uint64), generate


def grid() -> np.ndarray:
    """Centres from the corner of a tile, px: x of all blocks, y of all blocks, then x and y of each block's pixels."""
    row, column = np.divmod(np.arange(BLOCKS), ACROSS)
    blocks = np.stack([column * WIDTH + WIDTH / 2, row * HEIGHT + HEIGHT / 2])
    down, along = np.divmod(np.arange(LANES), WIDTH)
    pixels = np.stack([(column * WIDTH)[:, None] + along + 0.5, (row * HEIGHT)[:, None] + down + 0.5], axis=1)
    table = empty_aligned((2 * BLOCKS + pixels.size,), np.float32)
    table[:] = np.concatenate([blocks.ravel(), pixels.ravel()])
    return table


GRID = grid()


@kernel(inline=True)
def write_centres(pixels, size, grid):
    """The pixels' centres, in blocks of `size` floats."""
    for block in range(U(BLOCKS)):
        o, given = block * U(size), U(2 * BLOCKS) + block * U(2 * LANES)
        store(pixels, o + X, load(grid, given))
        store(pixels, o + Y, load(grid, given + U(LANES)))


@kernel(inline=True)
def write_transmittance(pixels, size, columns, rows):
    """T before any Gaussian; pixels beyond the image's columns and rows let nothing through."""
    for block in range(U(BLOCKS)):
        o = block * U(size)
        inside = select(greater(splat(F(columns)), load(pixels, o + X)), splat(F(1)), splat(DEAD))
        inside = select(greater(splat(F(rows)), load(pixels, o + Y)), inside, splat(DEAD))
        store(pixels, o + T, inside)


@kernel(inline=True)
def pixel_of(block, lane, left, top):
    """y and x in the image of a pixel of the tile that begins at (left, top)."""
    y = U(top) + block // U(ACROSS) * U(HEIGHT) + lane // U(WIDTH)
    x = U(left) + block % U(ACROSS) * U(WIDTH) + lane % U(WIDTH)
    return y, x


@kernel(inline=True)
def form_of(records, i, left, top):
    """dx0, dy0, A, B, C, o of log2(alpha) = o + A dx² + B dx dy + C dy²; (dx0, dy0) leads from the mean to the tile."""
    dx0 = splat((F(left) - records[i, FIRST_X]) - records[i, U_])
    dy0 = splat((F(top) - records[i, FIRST_Y]) - records[i, V_])
    A, B, C = splat(records[i, A_]), splat(records[i, B_]), splat(records[i, C_])
    return dx0, dy0, A, B, C, splat(records[i, LOG2_OPACITY])


@kernel(inline=True)
def log2_alpha_in(pixels, o, form):
    """log2(alpha) before its limits in the pixels of the block at o."""
    dx0, dy0, A, B, C, log2_opacity = form
    dx, dy = load(pixels, o + X) + dx0, load(pixels, o + Y) + dy0
    return dx * (dx * A + dy * B) + (dy * dy * C + log2_opacity)


@kernel(inline=True)
def within_reach(grid, form, log2_min_alpha):
    """The blocks in which log2(alpha) may reach log2_min_alpha.

    It is concave, so it lies below its tangent plane in the block's centre: below the value there and |slope| times the
    way to the outermost pixels.
    """
    dx0, dy0, A, B, C, log2_opacity = form
    dx = load(grid, 0) + dx0  # all registers of blocks have the same columns
    a, b = dx * A, dx * B
    along_x = dx * a + log2_opacity
    least = log2_min_alpha - ROUNDING
    blocks = NONE
    for first in range(0, BLOCKS, LANES):
        dy = load(grid, BLOCKS + first) + dy0
        c = dy * C
        middle = dy * (c + b) + along_x
        slope_x, slope_y = a * TWO + dy * B, c * TWO + b
        highest = middle + absolute(slope_x) * HALF_WIDTH + absolute(slope_y) * HALF_HEIGHT
        blocks |= lane_bits(greater_equal(highest, splat(least))) << U(first)
    return blocks
