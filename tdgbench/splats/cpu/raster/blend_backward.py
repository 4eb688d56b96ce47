"""The gradient of the blend, front to back as well: T is recomputed, one scalar per pixel holds the light behind.

Only the blocks in which the forward pass found weight are visited. With g the gradient of a pixel and
r_k = Σ_{j>k} w_j (c_j · g) + T_end (background · g − gradient of alpha):

    d/d ln(alpha_k) = w_k (c_k · g) − alpha_k / (1 − alpha_k) r_k

Every (tile, Gaussian) pair has a slot for the sums over the tile's pixels: (1, dx, dy, dx², dx dy, dy²) times the
above, then w_k g for the channels, and if asked for, |d/du| and |d/dv| of the image mean. The slots are summed later
in a fixed order, so that the result does not depend on which thread took which tile.
"""

from __future__ import annotations

import functools

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.alphas import COLUMN, DX, TWO, form_of, write_alphas, write_columns
from tdgbench.splats.cpu.raster.blend import channels_of
from tdgbench.splats.cpu.raster.blocks import (
    ACROSS,
    BLOCKS,
    LOCAL,
    NONE,
    TABLES,
    T,
    Y,
    first_pixel,
    is_inside,
    pixel_of,
    tile_at,
    write_centres,
    write_transmittance,
)
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.raster.types import ForwardPass, ImageArrays, Settings, Slots
from tdgbench.splats.cpu.simd.memory import (
    LINE,
    aligned_floats,
    load,
    load_channel,
    load_rows,
    prefetch,
    prefetch_row,
    store,
    store_anywhere,
    take_next,
)
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    absolute,
    both,
    broadcast,
    greater,
    greater_equal,
    lane_sums_of_4,
    lane_sums_of_8,
    lowest,
    reciprocal,
    select,
)

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)
LN_2 = F(np.log(2.0))
PREFETCH_DISTANCE = 4  # pairs
MOMENTS = 6


def slot_size(channels: int, absgrad: bool = False) -> int:
    """Return the number of floats of a gradient slot: six moments, the channels, and with absgrad two sums.

    >>> slot_size(4)
    10
    """
    return MOMENTS + channels + 2 * absgrad


def fill_slots(settings: Settings, view: ForwardPass, gradients: ImageArrays, slots: Slots) -> None:
    """Write the slot of every pair that has weight somewhere."""
    arguments = (
        np.zeros(1, np.int64), view.splats.values, view.tiles, settings.limits, TABLES, view.images, gradients,
        view.visits, slots,
    )  # fmt: skip
    channels = settings.channels
    kernel_of_view = make_blend_backward(channels.colors, channels.depth, channels.absgrad)
    pool.run(kernel_of_view, [arguments] * pool.get_threads())


@functools.cache
def make_blend_backward(colors: int, depth: bool, absgrad: bool):
    """Return the backward kernel of `tdgbench.splats.cpu.raster.blend.make_blend`."""
    variant = f"{colors}" + "_depth" * depth + "_absgrad" * absgrad
    channels = colors + depth
    # Floats of a block: y, T, light behind, then the gradients of the channels. No literal, so that helpers without
    # channels serve all variants.
    size = np.int64((3 + channels) * LANES)
    slot_floats = slot_size(channels, absgrad)

    @kernel(variant=variant)
    def blend_backward(counter, splats, tiles, limits, tables, images, gradients, visits, slots):
        """Write the slots of every pair that has weight somewhere, and mark them as written.

        Arguments as in `blend`; gradients: ImageArrays, of a loss; slots: Slots, written.
        """
        height, width = images.transmittance.shape
        tiles_x = (width + TILE - 1) // TILE
        n_tiles = tiles.starts.shape[0] - 1
        pixels, alphas = aligned_floats(BLOCKS * size), aligned_floats(BLOCKS * LANES)
        columns, sums = aligned_floats(ACROSS * COLUMN), aligned_floats(2 * LANES)
        write_centres(pixels, size, tables.centres)
        while True:
            index = take_next(counter)
            if index >= n_tiles:
                break
            tile = tile_at(index, tiles_x, tiles.starts)
            write_transmittance(pixels, size, tables.centres, width - tile.left, height - tile.top)
            write_gradients(pixels, size, colors, depth, tile, images, gradients)
            upcoming = tile_at(min(index + 1, n_tiles - 1), tiles_x, tiles.starts)
            for arrays in (images, gradients):
                prefetch_pixels(arrays.color, colors, upcoming, height, width)
                prefetch_pixels(arrays.transmittance, 1, upcoming, height, width)
                if depth:
                    prefetch_pixels(arrays.depth, 1, upcoming, height, width)
            end = tile.begin + visits.counts[index]
            for k in range(tile.begin, end):
                if k + PREFETCH_DISTANCE < end:
                    prefetch_row(splats, U(tiles.splat_ids[U(k + PREFETCH_DISTANCE)]))
                    prefetch(slots.values, U(tiles.slots[U(k + PREFETCH_DISTANCE)]) * U(slot_floats))
                blocks = U(visits.active_blocks[U(k)])
                if blocks == NONE:
                    continue
                i = U(tiles.splat_ids[U(k)])
                form = form_of(splats, i, tile)
                colors_of_splat = channels_of(splats, i)
                # first what needs no sums: the registers do not hold all at once
                write_columns(columns, form, tables.centres)
                write_alphas(alphas, pixels, size, columns, form, blocks, limits, tables.powers)
                totals = sum_blocks(
                    pixels, size, channels, alphas, columns, form, colors_of_splat, blocks, limits, absgrad
                )
                slot = U(tiles.slots[U(k)])
                slots.written[slot] = True
                at = slot * U(slot_floats)
                write_slot(slots.values, at, channels, totals, sums)
                if absgrad:
                    write_absolute(slots.values, at, channels, pixels, size, alphas, columns, form, blocks, sums)

    return blend_backward


@kernel(inline=True)
def write_gradients(pixels, size, colors, depth, tile, images, gradients):
    """Write each pixel's gradients, and as the light behind that of the whole pixel.

    Pixels beyond the image take the values of its edge, but have no light behind.
    """
    height, width = images.transmittance.shape
    if is_inside(tile, height, width):
        for block in range(U(BLOCKS)):
            o, at = block * U(size) + LOCAL, first_pixel(block, tile, width)
            behind = load_rows(images.transmittance, at, width) * load_rows(gradients.transmittance, at, width)
            for c in range(colors):
                g = load_channel(gradients.color, at, width, colors, c)
                store(pixels, o + U(LANES) * U(c + 1), g)
                behind += g * load_channel(images.color, at, width, colors, c)
            if depth:
                g = load_rows(gradients.depth, at, width)
                store(pixels, o + U(LANES * (colors + 1)), g)
                behind += g * load_rows(images.depth, at, width)
            store(pixels, o, behind)
        return
    for block in range(U(BLOCKS)):
        for lane in range(U(LANES)):
            o = block * U(size) + lane + LOCAL
            y, x = pixel_of(block, lane, tile)
            y, x = min(y, U(height - 1)), min(x, U(width - 1))
            behind = images.transmittance[y, x] * gradients.transmittance[y, x]
            for c in range(U(colors)):
                g = gradients.color[y, x, c]
                pixels[o + U(LANES) * (c + U(1))] = g
                behind += g * images.color[y, x, c]
            if depth:
                g = gradients.depth[y, x]
                pixels[o + U(LANES * (colors + 1))] = g
                behind += g * images.depth[y, x]
            pixels[o] = behind * pixels[o - LOCAL + T]


@kernel(inline=True)
def prefetch_pixels(image, channels, tile, height, width):
    """Prefetch the pixels of the next tile: its rows are far apart in memory, which hardware does not foresee.

    With several threads, mostly another one takes that tile.
    """
    for y in range(tile.top, min(tile.top + TILE, height)):
        end = (y * width + min(tile.left + TILE, width)) * channels - 1
        for c in range(channels):
            prefetch(image, U(end - c * LINE))


@kernel(inline=True)
def sum_blocks(pixels, size, channels, alphas, columns, form, colors, blocks, limits, absgrad):
    """Twelve registers: the six moments and up to six channels of one splat, summed over `blocks`.

    With absgrad, d/d ln(alpha) of each pixel takes the place of alpha.
    """
    zero = broadcast(ZERO)
    m0, mx, my, mxx, mxy, myy = zero, zero, zero, zero, zero, zero
    k0, k1, k2, k3, k4, k5 = zero, zero, zero, zero, zero, zero
    while blocks != NONE:
        block = lowest(blocks)
        blocks &= blocks - U(1)
        o = block * U(size)
        alpha = load(alphas, block * U(LANES))
        t = load(pixels, o + T)
        weight = alpha * t
        t_next = t - weight
        goes_on = greater_equal(t_next, limits.min_transmittance)
        pull = alpha * reciprocal(alpha - ONE)
        store(pixels, o + T, select(goes_on, t_next, zero))
        weight = select(goes_on, weight, zero)
        g0 = load(pixels, o + LOCAL + U(LANES))
        color_dot_g = g0 * colors[0]
        k0 = k0 + weight * g0
        if channels > 1:
            g1 = load(pixels, o + LOCAL + U(2 * LANES))
            color_dot_g = color_dot_g + g1 * colors[1]
            k1 = k1 + weight * g1
        if channels > 2:
            g2 = load(pixels, o + LOCAL + U(3 * LANES))
            color_dot_g = color_dot_g + g2 * colors[2]
            k2 = k2 + weight * g2
        if channels > 3:
            g3 = load(pixels, o + LOCAL + U(4 * LANES))
            color_dot_g = color_dot_g + g3 * colors[3]
            k3 = k3 + weight * g3
        if channels > 4:
            g4 = load(pixels, o + LOCAL + U(5 * LANES))
            color_dot_g = color_dot_g + g4 * colors[4]
            k4 = k4 + weight * g4
        if channels > 5:
            g5 = load(pixels, o + LOCAL + U(6 * LANES))
            color_dot_g = color_dot_g + g5 * colors[5]
            k5 = k5 + weight * g5
        light = weight * color_dot_g
        behind = load(pixels, o + LOCAL) - light
        store(pixels, o + LOCAL, behind)
        g = select(both(goes_on, greater(limits.max_alpha, alpha)), behind * pull + light, zero)
        if absgrad:
            store(alphas, block * U(LANES), g)
        dx, dy = load(columns, (block & U(ACROSS - 1)) * COLUMN + DX), load(pixels, o + Y) + form.dy
        g_dx, g_dy = g * dx, g * dy
        m0 = m0 + g
        mx, my = mx + g_dx, my + g_dy
        mxx, mxy, myy = mxx + g_dx * dx, mxy + g_dx * dy, myy + g_dy * dy
    return m0, mx, my, mxx, mxy, myy, k0, k1, k2, k3, k4, k5


@kernel(inline=True)
def write_slot(slots, o, channels, totals, sums):
    """slots[o : o + slot] = lane sums of the totals; sums (2 · LANES,) is scratch."""
    m0, mx, my, mxx, mxy, myy, k0, k1, k2, k3, k4, k5 = totals
    first_sums = lane_sums_of_8(m0, mx, my, mxx, mxy, myy, k0, k1)
    if LANES == 8 and MOMENTS + channels >= 8:
        store_anywhere(slots, o, first_sums)
    else:
        store(sums, 0, first_sums)
        for j in range(U(min(MOMENTS + channels, 8))):
            slots[o + j] = sums[j]
    if channels > 2:
        store(sums, LANES, lane_sums_of_4(k2, k3, k4, k5))
        for j in range(U(channels - 2)):
            slots[o + U(8) + j] = sums[U(LANES) + j]


@kernel(inline=True)
def write_absolute(slots, o, channels, pixels, size, alphas, columns, form, blocks, sums):
    """Write the last two numbers of a slot: Σ |d/du| and Σ |d/dv| of the image mean, per px; see `sum_blocks`."""
    u, v = broadcast(ZERO), broadcast(ZERO)
    while blocks != NONE:
        block = lowest(blocks)
        blocks &= blocks - U(1)
        g = load(alphas, block * U(LANES)) * LN_2
        dx, dy = load(columns, (block & U(ACROSS - 1)) * COLUMN + DX), load(pixels, block * U(size) + Y) + form.dy
        u = u + absolute(g * (dx * (form.A * TWO) + dy * form.B))
        v = v + absolute(g * (dy * (form.C * TWO) + dx * form.B))
    store(sums, 0, lane_sums_of_4(u, v, broadcast(ZERO), broadcast(ZERO)))
    for j in range(U(2)):
        slots[o + U(MOMENTS + channels) + j] = sums[j]
