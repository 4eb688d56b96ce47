"""Alpha blending of a tile, front to back (3DGS, eq. 3), a block of LANES pixels at a time.

    image_c = Σ_k c_k w_k + T background_c,  w_k = alpha_k T_k,  T_{k+1} = T_k (1 − alpha_k)

alpha is capped at max_alpha (0.99) and skipped below min_alpha (1/255); a pixel stops before the Gaussian that would
take T below min_transmittance (1e-4).
Stopped pixels need no branch: the sign bit of their T is set, which makes every further weight zero.
"""

from __future__ import annotations

import functools

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster import types as splat
from tdgbench.splats.cpu.raster.alphas import COLUMN, active_blocks, form_of, write_alphas, write_columns
from tdgbench.splats.cpu.raster.blocks import (
    ACROSS,
    ALL,
    BLOCKS,
    LOCAL,
    NONE,
    TABLES,
    T,
    first_pixel,
    is_inside,
    pixel_of,
    tile_at,
    write_centres,
    write_transmittance,
)
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.raster.types import ImageArrays, Settings, Splats, TileLists, Visits
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
    LANES,
    absolute,
    any_bit,
    any_positive,
    broadcast,
    greater_equal,
    lowest,
    maximum,
    negative_abs,
    select,
)

F, U = np.float32, np.uint64
ZERO = F(0)
BATCH = 16  # Gaussians whose active blocks are found before they are blended; then stopped blocks are looked for
PREFETCH_DISTANCE = 16  # pairs


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
