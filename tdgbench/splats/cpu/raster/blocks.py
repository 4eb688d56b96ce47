"""How a tile's pixels lie in registers: blocks of 4 × LANES / 4 pixels, numbered row by row from the tile's corner.

A small Gaussian touches fewer blocks than it would touch strips of one row. A set of blocks is a number, one bit each.
A kernel holds a tile as `pixels`, float32: `size` floats a block, of which X, Y and T are the same in all kernels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.raster.types import A_, B_, C_, CHANNELS, FIRST_X, FIRST_Y, LOG2_OPACITY, U_, V_
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.powers import COEFFICIENTS
from tdgbench.splats.cpu.simd.reductions import lane_bits
from tdgbench.splats.cpu.simd.registers import LANES, absolute, broadcast, greater, greater_equal, select

F, U = np.float32, np.uint64
WIDTH, HEIGHT = 4, LANES // 4  # of a block, px
ACROSS, DOWN = TILE // WIDTH, TILE // HEIGHT
BLOCKS = ACROSS * DOWN
X, Y, T, LOCAL = U(0), U(LANES), U(2 * LANES), U(3 * LANES)  # of a block: centres, transmittance, the kernel's values
ALL, NONE = U(2**BLOCKS - 1), U(0)
HALF_WIDTH, HALF_HEIGHT = F((WIDTH - 1) / 2), F((HEIGHT - 1) / 2)  # from a block's centre to its outermost pixels'
TWO, DEAD = F(2), F(-0.0)
ROUNDING = F(1 / 64)  # bound of the rounding error of log2(alpha)


class Tile(NamedTuple):
    """A tile: its corner in px, and its pairs [begin, end) in the tile lists."""

    left: int
    top: int
    begin: int
    end: int


class Form(NamedTuple):
    """log2(alpha) = log2_opacity + A dx² + B dx dy + C dy², registers; (dx, dy) leads from the mean to the tile, px."""

    dx: float
    dy: float
    A: float
    B: float
    C: float
    log2_opacity: float


class BlockTables(NamedTuple):
    """Constants that the blend kernels read from memory."""

    centres: np.ndarray  # float32: x of all blocks, y of all blocks, then x and y of each block's pixels, px
    powers: np.ndarray  # (6 · LANES,) float32, see `tdgbench.splats.cpu.simd.powers`


def _centres() -> np.ndarray:
    """Return centres of blocks and pixels, counted from the corner of a tile."""
    row, column = np.divmod(np.arange(BLOCKS), ACROSS)
    blocks = np.stack([column * WIDTH + WIDTH / 2, row * HEIGHT + HEIGHT / 2])
    down, along = np.divmod(np.arange(LANES), WIDTH)
    pixels = np.stack([(column * WIDTH)[:, None] + along + 0.5, (row * HEIGHT)[:, None] + down + 0.5], axis=1)
    table = empty_aligned((2 * BLOCKS + pixels.size,), np.float32)
    table[:] = np.concatenate([blocks.ravel(), pixels.ravel()])
    return table


TABLES = BlockTables(_centres(), COEFFICIENTS)


@intrinsic
def lowest(typing_context, blocks):
    """Number of the first block of a non-empty set."""

    def generate(context, builder, signature, args):
        long, bit = ir.IntType(64), ir.IntType(1)
        name = "llvm.cttz.i64"
        known = builder.module.globals.get(name)
        function = known or ir.Function(builder.module, ir.FunctionType(long, [long, bit]), name)
        return builder.call(function, [args[0], bit(1)])

    return types.uint64(types.uint64), generate


@kernel(inline=True)
def tile_at(index, tiles_x, starts):
    """Tile number `index` of an image of tiles_x tiles a row; starts (tiles + 1,): first pair of each."""
    return Tile((index % tiles_x) * TILE, (index // tiles_x) * TILE, starts[index], starts[index + 1])


@kernel(inline=True)
def write_centres(pixels, size, centres):
    """Write the pixels' centres."""
    for block in range(U(BLOCKS)):
        o, given = block * U(size), U(2 * BLOCKS) + block * U(2 * LANES)
        store(pixels, o + X, load(centres, given))
        store(pixels, o + Y, load(centres, given + U(LANES)))


@kernel(inline=True)
def write_transmittance(pixels, size, columns, rows):
    """Write T before any Gaussian; pixels beyond the image's remaining columns and rows let nothing through."""
    for block in range(U(BLOCKS)):
        o = block * U(size)
        inside = select(greater(broadcast(F(columns)), load(pixels, o + X)), broadcast(F(1)), broadcast(DEAD))
        inside = select(greater(broadcast(F(rows)), load(pixels, o + Y)), inside, broadcast(DEAD))
        store(pixels, o + T, inside)


@kernel(inline=True)
def pixel_of(block, lane, tile):
    """y and x in the image of a pixel of a tile."""
    y = U(tile.top) + block // U(ACROSS) * U(HEIGHT) + lane // U(WIDTH)
    x = U(tile.left) + block % U(ACROSS) * U(WIDTH) + lane % U(WIDTH)
    return y, x


@kernel(inline=True)
def form_of(splats, i, tile):
    """Form of row i of splats (n, 16), relative to a tile."""
    return Form(
        broadcast((F(tile.left) - splats[i, FIRST_X]) - splats[i, U_]),
        broadcast((F(tile.top) - splats[i, FIRST_Y]) - splats[i, V_]),
        broadcast(splats[i, A_]),
        broadcast(splats[i, B_]),
        broadcast(splats[i, C_]),
        broadcast(splats[i, LOG2_OPACITY]),
    )


@kernel(inline=True)
def channels_of(splats, i):
    """Four registers: the channels of row i of splats (n, 16); those not in use hold anything."""
    return (
        broadcast(splats[i, CHANNELS]),
        broadcast(splats[i, CHANNELS + 1]),
        broadcast(splats[i, CHANNELS + 2]),
        broadcast(splats[i, CHANNELS + 3]),
    )


@kernel(inline=True)
def log2_alpha_in(pixels, o, form):
    """log2(alpha) before its limits in the pixels of the block at o."""
    dx, dy = load(pixels, o + X) + form.dx, load(pixels, o + Y) + form.dy
    return dx * (dx * form.A + dy * form.B) + (dy * dy * form.C + form.log2_opacity)


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
