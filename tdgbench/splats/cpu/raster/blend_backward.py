"""The gradient of the blend, front to back as well: T is recomputed, one scalar per pixel holds the light behind.

Only blocks in which the forward pass found weight are visited.

With g the gradient of a pixel, r_k = Σ_{j>k} w_j (c_j · g) + T_end (background · g − gradient of alpha):

    d/d ln(alpha_k) = w_k (c_k · g) − alpha_k / (1 − alpha_k) r_k

Every (tile, Gaussian) pair owns a slot into which this kernel writes the sums over the tile's pixels
(1, dx, dy, dx², dx dy, dy² times the above; w_k g for the channels). The slots are summed later in a fixed order,
so that the result does not depend on which thread took which tile.
"""

from __future__ import annotations

import functools

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blend import ONE, ZERO
from tdgbench.splats.cpu.raster.blocks import (
    BLOCKS,
    NONE,
    OWN,
    T,
    X,
    Y,
    form_of,
    log2_alpha_in,
    lowest,
    pixel_of,
    write_centres,
    write_transmittance,
)
from tdgbench.splats.cpu.raster.limits import LOG2_MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE
from tdgbench.splats.cpu.raster.records import CHANNELS
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.simd.memory import (
    aligned_floats,
    load,
    prefetch,
    prefetch_row,
    store,
    store_anywhere,
    take_next,
)
from tdgbench.splats.cpu.simd.powers import exp2_in_memory
from tdgbench.splats.cpu.simd.reductions import lane_sums_of_4, lane_sums_of_8
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    both,
    greater,
    greater_equal,
    less_equal,
    maximum,
    minimum,
    negative_abs,
    reciprocal,
    select,
    splat,
)

F, U = np.float32, np.uint64
LOOK_AHEAD = 4


def slot_size(channels: int) -> int:
    """Floats per gradient slot: six moments and the channels."""
    return 6 + channels


@functools.cache
def make_blend_backward(colors: int, depth: bool):
    """The backward kernel of `make_blend`."""
    channels = colors + depth
    block_size = (4 + channels) * LANES  # x, y, T, light behind, then the gradients of the channels
    size = slot_size(channels)

    @kernel(variant=f"{colors}_depth" if depth else f"{colors}")
    def blend_backward(counter, width, height, records, tile_start, gaussian_of, slot_of, limits, powers, grid,
                       image, depth_map, transmittance, grad_image, grad_depth, grad_transmittance, reached, lit,
                       slots, written):  # fmt: skip
        """Write the slots of every pair that has weight somewhere, and mark them as written."""
        tiles_x = (width + TILE - 1) // TILE
        n_tiles = tile_start.shape[0] - 1
        max_alpha, log2_min_alpha = limits[MAX_ALPHA], limits[LOG2_MIN_ALPHA]
        min_transmittance = limits[MIN_TRANSMITTANCE]
        pixels, alphas = aligned_floats(BLOCKS * block_size), aligned_floats(2 * BLOCKS * LANES)
        sums = aligned_floats(2 * LANES)
        write_centres(pixels, block_size, grid)
        zero = splat(ZERO)
        while True:
            tile = take_next(counter)
            if tile >= n_tiles:
                break
            left = (tile % tiles_x) * TILE
            top = (tile // tiles_x) * TILE
            write_transmittance(pixels, block_size, width - left, height - top)
            for block in range(U(BLOCKS)):
                for lane in range(U(LANES)):
                    o = block * U(block_size) + lane + OWN
                    # pixels beyond the image take the values of its edge, but have no light behind
                    y, x = pixel_of(block, lane, left, top)
                    y, x = min(y, U(height - 1)), min(x, U(width - 1))
                    behind = transmittance[y, x] * grad_transmittance[y, x]
                    for c in range(U(colors)):
                        g = grad_image[y, x, c]
                        pixels[o + U(LANES) * (c + U(1))] = g
                        behind += g * image[y, x, c]
                    if depth:
                        g = grad_depth[y, x]
                        pixels[o + U(LANES * (colors + 1))] = g
                        behind += g * depth_map[y, x]
                    pixels[o] = behind * pixels[o - OWN + T]
            begin = tile_start[tile]
            end = begin + reached[tile]
            for k in range(begin, end):
                if k + LOOK_AHEAD < end:
                    prefetch_row(records, U(gaussian_of[U(k + LOOK_AHEAD)]))
                    prefetch(slots, U(slot_of[U(k + LOOK_AHEAD)]) * U(size))
                blocks = U(lit[U(k)])
                if blocks == NONE:
                    continue
                i = U(gaussian_of[U(k)])
                form = form_of(records, i, left, top)
                dx0, dy0, _, _, _, _ = form
                c0, c1 = splat(records[i, CHANNELS]), splat(records[i, CHANNELS + 1])
                c2, c3 = splat(records[i, CHANNELS + 2]), splat(records[i, CHANNELS + 3])
                ahead = blocks  # first what needs no sums: the registers do not hold all at once
                while ahead != NONE:
                    block = lowest(ahead)
                    ahead &= ahead - U(1)
                    o = block * U(block_size)
                    log2_alpha = log2_alpha_in(pixels, o, form)
                    uncapped = exp2_in_memory(log2_alpha, powers)
                    uncapped = select(greater_equal(log2_alpha, log2_min_alpha), uncapped, zero)
                    alpha = minimum(uncapped, max_alpha)
                    pull = select(less_equal(uncapped, max_alpha), alpha * reciprocal(alpha - ONE), splat(ONE))
                    store(alphas, block * U(2 * LANES), alpha)
                    store(alphas, block * U(2 * LANES) + U(LANES), pull)
                m0 = zero
                mx = zero
                my = zero
                mxx = zero
                mxy = zero
                myy = zero
                k0 = zero
                k1 = zero
                k2 = zero
                k3 = zero
                while blocks != NONE:
                    block = lowest(blocks)
                    blocks &= blocks - U(1)
                    o = block * U(block_size)
                    t = load(pixels, o + T)
                    t_alive = maximum(t, zero)
                    weight = load(alphas, block * U(2 * LANES)) * t_alive
                    t_next = t_alive - weight
                    goes_on = greater_equal(t_next, min_transmittance)
                    store(pixels, o + T, select(goes_on, t_next, negative_abs(t)))
                    weight = select(goes_on, weight, zero)
                    g0 = load(pixels, o + OWN + U(LANES))
                    color_dot_g = g0 * c0
                    k0 = k0 + weight * g0
                    if channels > 1:
                        g1 = load(pixels, o + OWN + U(2 * LANES))
                        color_dot_g = color_dot_g + g1 * c1
                        k1 = k1 + weight * g1
                    if channels > 2:
                        g2 = load(pixels, o + OWN + U(3 * LANES))
                        color_dot_g = color_dot_g + g2 * c2
                        k2 = k2 + weight * g2
                    if channels > 3:
                        g3 = load(pixels, o + OWN + U(4 * LANES))
                        color_dot_g = color_dot_g + g3 * c3
                        k3 = k3 + weight * g3
                    own = weight * color_dot_g
                    behind = load(pixels, o + OWN) - own
                    store(pixels, o + OWN, behind)
                    pull = load(alphas, block * U(2 * LANES) + U(LANES))
                    moves = both(goes_on, greater(zero, pull))
                    g = select(moves, behind * pull + own, zero)
                    dx = load(pixels, o + X) + dx0
                    g_dx = g * dx
                    m0 = m0 + g
                    mx = mx + g_dx
                    mxx = mxx + g_dx * dx
                    dy = load(pixels, o + Y) + dy0
                    g_dy = g * dy
                    mxy = mxy + g_dx * dy
                    my = my + g_dy
                    myy = myy + g_dy * dy
                slot = U(slot_of[U(k)])
                written[slot] = True
                o = slot * U(size)
                first_sums = lane_sums_of_8(m0, mx, my, mxx, mxy, myy, k0, k1)
                if LANES == 8 and size >= 8:
                    store_anywhere(slots, o, first_sums)
                else:
                    store(sums, 0, first_sums)
                    for j in range(U(min(size, 8))):
                        slots[o + j] = sums[j]
                if channels > 2:
                    store(sums, LANES, lane_sums_of_4(k2, k3, zero, zero))
                    slots[o + U(8)] = sums[U(LANES)]
                    if channels > 3:
                        slots[o + U(9)] = sums[U(LANES + 1)]

    return blend_backward
