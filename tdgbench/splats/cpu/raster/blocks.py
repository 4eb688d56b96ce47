"""The pixels of a tile in blocks of LANES, as the blend and its gradient hold them.

Blocks are 4 × LANES / 4 pixels, numbered row by row from the tile's corner: a small Gaussian touches fewer of them than
it would touch strips of one row. A set of blocks is a number, one bit each. A kernel holds a tile as `pixels`, float32:
`size` floats a block, of which Y and T are the same in all kernels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.registers import EXP2, LANES, broadcast, greater, select

F, U = np.float32, np.uint64
WIDTH, HEIGHT = 4, LANES // 4  # of a block, px
ACROSS, DOWN = TILE // WIDTH, TILE // HEIGHT
BLOCKS = ACROSS * DOWN
Y, T, LOCAL = U(0), U(LANES), U(2 * LANES)  # of a block: centres, transmittance, the kernel's values
ALL, NONE = U(2**BLOCKS - 1), U(0)
DEAD = F(-0.0)  # T of a pixel that lets nothing through


class Tile(NamedTuple):
    """A tile: its corner in px, and its pairs [begin, end) in the tile lists."""

    left: int
    top: int
    begin: int
    end: int


class BlockTables(NamedTuple):
    """Constants that the kernels of the blend read from memory, float32."""

    centres: np.ndarray  # x of all blocks, y of all blocks, then x and y of each block's pixels, px from the corner
    powers: np.ndarray  # (6 · LANES,): each coefficient of `exp2` as a register


def _tables() -> BlockTables:
    row, column = np.divmod(np.arange(BLOCKS), ACROSS)
    blocks = np.stack([column * WIDTH + WIDTH / 2, row * HEIGHT + HEIGHT / 2])
    down, along = np.divmod(np.arange(LANES), WIDTH)
    pixels = np.stack([(column * WIDTH)[:, None] + along + 0.5, (row * HEIGHT)[:, None] + down + 0.5], axis=1)
    centres, powers = (empty_aligned((count,), np.float32) for count in (2 * BLOCKS + pixels.size, len(EXP2) * LANES))
    centres[:], powers[:] = np.concatenate([blocks.ravel(), pixels.ravel()]), np.repeat(EXP2, LANES)
    return BlockTables(centres, powers)


TABLES = _tables()


@kernel(inline=True)
def tile_at(index, tiles_x, starts):
    """Tile number `index` of an image of tiles_x tiles a row; starts (tiles + 1,): first pair of each."""
    return Tile((index % tiles_x) * TILE, (index // tiles_x) * TILE, starts[index], starts[index + 1])


@kernel(inline=True)
def write_centres(pixels, size, centres):
    """Write y of the pixels' centres."""
    for block in range(U(BLOCKS)):
        store(pixels, block * U(size) + Y, load(centres, U(2 * BLOCKS + LANES) + block * U(2 * LANES)))


@kernel(inline=True)
def write_transmittance(pixels, size, centres, columns, rows):
    """Write T before any Gaussian; pixels beyond the image's remaining columns and rows let nothing through."""
    for block in range(U(BLOCKS)):
        o, x = block * U(size), load(centres, U(2 * BLOCKS) + block * U(2 * LANES))
        inside = select(greater(broadcast(F(columns)), x), broadcast(F(1)), broadcast(DEAD))
        inside = select(greater(broadcast(F(rows)), load(pixels, o + Y)), inside, broadcast(DEAD))
        store(pixels, o + T, inside)


@kernel(inline=True)
def is_inside(tile, height, width):
    """Whether all pixels of a tile are in the image."""
    return tile.left + TILE <= width and tile.top + TILE <= height


@kernel(inline=True)
def first_pixel(block, tile, width):
    """Number in the image of a block's first pixel."""
    return (tile.top + np.int64(block // U(ACROSS)) * HEIGHT) * width + tile.left + np.int64(block % U(ACROSS)) * WIDTH


@kernel(inline=True)
def pixel_of(block, lane, tile):
    """y and x in the image of a pixel of a tile."""
    y = U(tile.top) + block // U(ACROSS) * U(HEIGHT) + lane // U(WIDTH)
    x = U(tile.left) + block % U(ACROSS) * U(WIDTH) + lane % U(WIDTH)
    return y, x
