"""Alpha blending of a tile, front to back (3DGS, eq. 3), a block of LANES pixels at a time.

    image_c = Σ_k c_k w_k + T background_c,  w_k = alpha_k T_k,  T_{k+1} = T_k (1 − alpha_k)

alpha is capped at max_alpha (0.99) and skipped below min_alpha (1/255); a pixel stops before the Gaussian that would
take T below min_transmittance (1e-4).
Stopped pixels need no branch: the sign bit of their T is set, which makes every further weight zero.

Blocks are 4 × LANES / 4 pixels, numbered row by row from the tile's corner: a small Gaussian touches fewer of them than
it would touch strips of one row. A set of blocks is a number, one bit each. A kernel holds a tile as `pixels`, float32:
`size` floats a block, of which Y and T are the same in all kernels.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster import types as splat
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.raster.types import ImageArrays, Settings, Splats, TileLists, Visits
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import (
    aligned_floats,
    load,
    prefetch_row,
    store,
    store_channel,
    store_rows,
    take_next,
)
from tdgbench.splats.cpu.simd.registers import (
    EXP2,
    LANES,
    absolute,
    any_bit,
    any_positive,
    broadcast,
    exp2_by,
    greater,
    greater_equal,
    lane_bits,
    lowest,
    maximum,
    minimum,
    negative_abs,
    select,
)

F, U = np.float32, np.uint64
WIDTH, HEIGHT = 4, LANES // 4  # of a block, px
ACROSS, DOWN = TILE // WIDTH, TILE // HEIGHT
BLOCKS = ACROSS * DOWN
Y, T, LOCAL = U(0), U(LANES), U(2 * LANES)  # of a block: centres, transmittance, the kernel's values
DX, DX_B, ALONG_X, COLUMN = U(0), U(LANES), U(2 * LANES), U(4 * LANES)  # of a column of blocks; its floats
ALL, NONE = U(2**BLOCKS - 1), U(0)
HALF_WIDTH, HALF_HEIGHT = F((WIDTH - 1) / 2), F((HEIGHT - 1) / 2)  # from a block's centre to its outermost pixels'
ZERO, TWO, DEAD = F(0), F(2), F(-0.0)
ROUNDING = F(1 / 64)  # bound of the rounding error of log2(alpha)
BATCH = 16  # Gaussians whose active blocks are found before they are blended; then stopped blocks are looked for
PREFETCH_DISTANCE = 16  # pairs


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

    centres: (
        np.ndarray
    )  # float32: x of all blocks, y of all blocks, then x and y of each block's pixels, px from the corner
    powers: np.ndarray  # (6 · LANES,) float32: each coefficient of `exp2` as a register


def _tables() -> BlockTables:
    row, column = np.divmod(np.arange(BLOCKS), ACROSS)
    blocks = np.stack([column * WIDTH + WIDTH / 2, row * HEIGHT + HEIGHT / 2])
    down, along = np.divmod(np.arange(LANES), WIDTH)
    pixels = np.stack([(column * WIDTH)[:, None] + along + 0.5, (row * HEIGHT)[:, None] + down + 0.5], axis=1)
    centres, powers = (empty_aligned((count,), np.float32) for count in (2 * BLOCKS + pixels.size, len(EXP2) * LANES))
    centres[:], powers[:] = np.concatenate([blocks.ravel(), pixels.ravel()]), np.repeat(EXP2, LANES)
    return BlockTables(centres, powers)


TABLES = _tables()


def blend_tiles(settings: Settings, splats: Splats, tiles: TileLists, active_blocks: np.ndarray):
    """Blend all tiles; fills active_blocks (pairs,), uint32. Returns ImageArrays and Visits."""
    size = (settings.height, settings.width)
    images = ImageArrays(
        np.empty((*size, len(settings.background)), np.float32),
        np.empty(size if settings.channels.depth else (0, 0), np.float32),
        np.empty(size, np.float32),
    )
    visits = Visits(np.empty(len(tiles.starts) - 1, np.int32), active_blocks)
    arguments = (
        np.zeros(1, np.int64), splats.values, tiles, settings.background, settings.limits, TABLES, images, visits,
    )  # fmt: skip
    pool.run(make_blend(settings.channels.colors, settings.channels.depth), [arguments] * pool.get_threads())
    return images, visits


@functools.cache
def make_blend(colors: int, depth: bool):
    """Return the forward kernel for `colors` channels, and depth as one more; 1 to MAX_CHANNELS in all."""
    variant = f"{colors}_depth" if depth else f"{colors}"
    # not literals: one helper serves all variants
    channels, colors, depth = np.int64(colors + depth), np.int64(colors), np.bool_(depth)
    size = (2 + channels) * LANES  # floats of a block: y, T, then the channels

    @kernel(variant=variant)
    def blend(counter, splats, tiles, background, limits, tables, images, visits):
        """Blend the tiles that counter (1,) hands out, until none remains.

        splats (n, 16); tiles: TileLists; background (colours,); limits: Limits; tables: BlockTables; images:
        ImageArrays and visits: Visits, both written.
        """
        height, width = images.transmittance.shape
        tiles_x = (width + TILE - 1) // TILE
        n_tiles = tiles.starts.shape[0] - 1
        pixels, alphas = aligned_floats(BLOCKS * size), aligned_floats(BLOCKS * LANES)
        columns = aligned_floats(ACROSS * COLUMN)
        write_centres(pixels, size, tables.centres)
        while True:
            index = take_next(counter)
            if index >= n_tiles:
                break
            tile = tile_at(index, tiles_x, tiles.starts)
            write_transmittance(pixels, size, tables.centres, width - tile.left, height - tile.top)
            for block in range(U(BLOCKS)):
                for c in range(U(channels)):
                    store(pixels, block * U(size) + LOCAL + U(LANES) * c, broadcast(ZERO))
            alive = ALL
            done = tile.end
            for first in range(tile.begin, tile.end, BATCH):
                last = min(first + BATCH, tile.end)
                find_active(first, last, splats, tiles.splat_ids, tile, limits, tables, alive, visits.active_blocks)
                for k in range(U(first), U(last)):
                    i, blocks = U(tiles.splat_ids[k]), U(visits.active_blocks[k])
                    form = form_of(splats, i, tile)
                    write_columns(columns, form, tables.centres)
                    write_alphas(alphas, pixels, size, columns, form, blocks, limits, tables.powers)
                    visits.active_blocks[k] = add_splat(
                        pixels, size, channels, alphas, channels_of(splats, i), blocks, limits.min_transmittance
                    )
                if limits.end_early:
                    alive = still_alive(alive, pixels, size)
                    if alive == NONE:
                        done = last
                        break
            visits.counts[index] = done - tile.begin
            write_pixels(pixels, size, colors, depth, tile, background, images)

    return blend


@kernel(inline=True)
def find_active(first, last, splats, splat_ids, tile, limits, tables, alive, found):
    """found[first:last] = of the blocks `alive`, those in which a pair may have weight."""
    for k in range(U(first), U(last)):
        i = U(splat_ids[k])
        prefetch_row(splats, U(splat_ids[min(k + U(PREFETCH_DISTANCE), U(tile.end - 1))]))
        found[k] = active_blocks(tables.centres, form_of(splats, i, tile), limits.log2_min_alpha) & alive


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
def add_splat(pixels, size, channels, alphas, colors, blocks, min_transmittance):
    """Blend one splat into `blocks`; returns those in which it has weight. colors: six registers."""
    zero = broadcast(ZERO)
    weighted = NONE
    while blocks != NONE:
        block = lowest(blocks)
        blocks &= blocks - U(1)
        o = block * U(size)
        t = load(pixels, o + T)
        t_alive = maximum(t, zero)
        weight = load(alphas, block * U(LANES)) * t_alive
        weighted |= U(any_bit(weight)) << block
        t_next = t_alive - weight
        goes_on = greater_equal(t_next, min_transmittance)
        store(pixels, o + T, select(goes_on, t_next, negative_abs(t)))
        add_light(pixels, o + LOCAL, channels, select(goes_on, weight, zero), colors)
    return weighted


@kernel(inline=True)
def add_light(pixels, o, channels, weight, colors):
    """Add weight times the splat's channels to those that begin at o."""
    o1, o2, o3, o4, o5 = o + U(LANES), o + U(2 * LANES), o + U(3 * LANES), o + U(4 * LANES), o + U(5 * LANES)
    store(pixels, o, load(pixels, o) + weight * colors[0])
    if channels > 1:
        store(pixels, o1, load(pixels, o1) + weight * colors[1])
    if channels > 2:
        store(pixels, o2, load(pixels, o2) + weight * colors[2])
    if channels > 3:
        store(pixels, o3, load(pixels, o3) + weight * colors[3])
    if channels > 4:
        store(pixels, o4, load(pixels, o4) + weight * colors[4])
    if channels > 5:
        store(pixels, o5, load(pixels, o5) + weight * colors[5])


@kernel(inline=True)
def still_alive(alive, pixels, size):
    """Those of the blocks `alive` in which some pixel still lets light through."""
    remaining = alive
    while remaining != NONE:
        block = lowest(remaining)
        remaining &= remaining - U(1)
        if not any_positive(load(pixels, block * U(size) + T)):
            alive &= ~(U(1) << block)
    return alive


@kernel(inline=True)
def write_pixels(pixels, size, colors, depth, tile, background, images):
    """Write a finished tile to the images, over the background."""
    height, width = images.transmittance.shape
    if is_inside(tile, height, width):
        for block in range(U(BLOCKS)):
            o, at = block * U(size), first_pixel(block, tile, width)
            t = absolute(load(pixels, o + T))
            store_rows(images.transmittance, at, width, t)
            for c in range(colors):
                color = load(pixels, o + LOCAL + U(LANES) * U(c)) + t * background[c]
                store_channel(images.color, at, width, colors, c, color)
            if depth:
                store_rows(images.depth, at, width, load(pixels, o + LOCAL + U(LANES * colors)))
        return
    for block in range(U(BLOCKS)):
        for lane in range(U(LANES)):
            y, x = pixel_of(block, lane, tile)
            if y < U(height) and x < U(width):
                o = block * U(size) + lane
                t = abs(pixels[o + T])
                images.transmittance[y, x] = t
                for c in range(U(colors)):
                    images.color[y, x, c] = pixels[o + LOCAL + U(LANES) * c] + t * background[c]
                if depth:
                    images.depth[y, x] = pixels[o + LOCAL + U(LANES * colors)]


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
def channels_of(splats, i):
    """Six registers: the channels of row i of splats (n, 16); those not in use hold anything."""
    return (
        broadcast(splats[i, splat.CHANNELS]),
        broadcast(splats[i, splat.CHANNELS + 1]),
        broadcast(splats[i, splat.CHANNELS + 2]),
        broadcast(splats[i, splat.CHANNELS + 3]),
        broadcast(splats[i, splat.CHANNELS + 4]),
        broadcast(splats[i, splat.CHANNELS + 5]),
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
