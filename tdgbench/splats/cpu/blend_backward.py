"""The gradient of the blend, front to back as well: T is recomputed, one scalar per pixel holds the light behind.

With g the gradient of a pixel, r_k = Σ_{j>k} w_j (c_j · g) + T_end (background · g − gradient of alpha):

    d/d ln(alpha_k) = w_k (c_k · g) − alpha_k / (1 − alpha_k) r_k

Every (tile, Gaussian) pair owns a slot into which this kernel writes the sums over the tile's pixels
(1, dx, dy, dx², dx dy, dy² times the above; w_k g for the channels). The slots are summed later in a fixed order,
so that the result does not depend on which thread took which tile.
"""

from __future__ import annotations

import functools

import numpy as np
from numba import int64

from tdgbench.splats.cpu.blend import (
    BLOCKS,
    CHECK_EVERY,
    DEAD,
    HALF,
    LOOK_AHEAD,
    ONE,
    ZERO,
    row_alive,
)
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.limits import END_EARLY, LOG2_MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE
from tdgbench.splats.cpu.memory import aligned_floats, load, prefetch, prefetch_row, store, store_anywhere, take_next
from tdgbench.splats.cpu.records import (
    A_,
    B_,
    C_,
    CHANNELS,
    FIRST_X,
    FIRST_Y,
    LAST_X,
    LAST_Y,
    LOG2_OPACITY,
    U_,
    V_,
)
from tdgbench.splats.cpu.reductions import lane_sums_of_4, lane_sums_of_8
from tdgbench.splats.cpu.simd import (
    LANES,
    absolute,
    both,
    exp2,
    exp2_rough,
    greater,
    greater_equal,
    lane_index,
    less_equal,
    maximum,
    minimum,
    negative_abs,
    reciprocal,
    select,
    splat,
)
from tdgbench.splats.cpu.tiles import TILE

F, U = np.float32, np.uint64
TWO = F(2)


def slot_size(channels: int, absgrad: bool) -> int:
    """Floats per gradient slot: six moments, the channels, and with absgrad the two absolute sums."""
    return 6 + channels + 2 * absgrad


@functools.cache
def make_blend_backward(colors: int, depth: bool, absgrad: bool, rough_exp: bool):
    """The backward kernel of `make_blend`; with `absgrad` also Σ |d/du|, Σ |d/dv| over the pixels."""
    channels = colors + depth
    block = (2 + channels) * LANES  # per register: T, light behind, then the gradients of the channels
    row = BLOCKS * block
    size = slot_size(channels, absgrad)

    @kernel()
    def blend_backward(counter, width, height, records, tile_start, gaussian_of, slot_of, limits,
                       image, depth_map, transmittance, grad_image, grad_depth, grad_transmittance, reached,
                       slots):  # fmt: skip
        """Write the slots of every pair; those that were not looked at become zero."""
        tiles_x = (width + TILE - 1) // TILE
        n_tiles = tile_start.shape[0] - 1
        max_alpha, log2_min_alpha = limits[MAX_ALPHA], limits[LOG2_MIN_ALPHA]
        min_transmittance, end_early = limits[MIN_TRANSMITTANCE], limits[END_EARLY] > ZERO
        pixels = aligned_floats(TILE * row + 3 * TILE)
        row_y = pixels[TILE * row :]
        row_b = row_y[TILE:]
        row_c = row_b[TILE:]
        zero = splat(ZERO)
        centre = lane_index() + HALF
        while True:
            tile = take_next(counter)
            if tile >= n_tiles:
                break
            left = (tile % tiles_x) * TILE
            top = (tile // tiles_x) * TILE
            for b in range(U(TILE)):
                for a in range(U(TILE)):
                    y, x = U(top) + b, U(left) + a
                    o = b * U(row) + (a // U(LANES)) * U(block) + a % U(LANES)
                    if y < U(height) and x < U(width):
                        pixels[o] = ONE
                        behind = transmittance[y, x] * grad_transmittance[y, x]
                        for c in range(U(colors)):
                            g = grad_image[y, x, c]
                            pixels[o + U(LANES) * (c + U(2))] = g
                            behind += g * image[y, x, c]
                        if depth:
                            g = grad_depth[y, x]
                            pixels[o + U(LANES * (colors + 2))] = g
                            behind += g * depth_map[y, x]
                        pixels[o + U(LANES)] = behind
                    else:
                        pixels[o] = DEAD
                        for c in range(U(channels + 1)):
                            pixels[o + U(LANES) * (c + U(1))] = ZERO
            begin = tile_start[tile]
            end = begin + reached[tile]
            first_row, last_row = 0, TILE - 1
            for k in range(begin, end):
                i = U(gaussian_of[U(k)])
                if k + LOOK_AHEAD < end:
                    prefetch_row(records, U(gaussian_of[U(k + LOOK_AHEAD)]))
                    prefetch(slots, U(slot_of[U(k + LOOK_AHEAD)]) * U(size))
                y0 = max(int64(records[i, FIRST_Y]) - top, first_row)
                y1 = min(int64(records[i, LAST_Y]) - top, last_row)
                dx0 = (F(left) - records[i, FIRST_X]) - records[i, U_]
                dy0 = (F(top) - records[i, FIRST_Y]) - records[i, V_]
                A, B, C = records[i, A_], records[i, B_], records[i, C_]
                for h in range(0, TILE, LANES):
                    dy = centre + (dy0 + F(h))
                    store(row_y, h, dy)
                    store(row_b, h, dy * B)
                    store(row_c, h, dy * dy * C)
                c0, c1 = records[i, CHANNELS], records[i, CHANNELS + 1]
                c2, c3 = records[i, CHANNELS + 2], records[i, CHANNELS + 3]
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
                abs_u = zero
                abs_v = zero
                for part in range(BLOCKS):
                    x0 = left + part * LANES
                    if BLOCKS == 2 and (records[i, LAST_X] < F(x0) or records[i, FIRST_X] >= F(x0 + LANES)):
                        continue
                    dx = centre + (dx0 + F(part * LANES))
                    along_x = dx * dx * A + records[i, LOG2_OPACITY]
                    column_0 = zero
                    column_y = zero
                    column_yy = zero
                    for row_index in range(y0, y1 + 1):
                        o = row_index * row + part * block
                        dy = row_y[U(row_index)]
                        log2_alpha = dx * row_b[U(row_index)] + (along_x + row_c[U(row_index)])
                        uncapped = exp2_rough(log2_alpha) if rough_exp else exp2(log2_alpha)
                        alpha = minimum(uncapped, max_alpha)
                        t = load(pixels, o)
                        t_alive = maximum(t, zero)
                        weight = select(greater_equal(log2_alpha, log2_min_alpha), alpha * t_alive, zero)
                        t_next = t_alive - weight
                        goes_on = greater_equal(t_next, min_transmittance)
                        store(pixels, o, select(goes_on, t_next, negative_abs(t)))
                        weight = select(goes_on, weight, zero)
                        g0 = load(pixels, o + 2 * LANES)
                        color_dot_g = g0 * c0
                        k0 = k0 + weight * g0
                        if channels > 1:
                            g1 = load(pixels, o + 3 * LANES)
                            color_dot_g = color_dot_g + g1 * c1
                            k1 = k1 + weight * g1
                        if channels > 2:
                            g2 = load(pixels, o + 4 * LANES)
                            color_dot_g = color_dot_g + g2 * c2
                            k2 = k2 + weight * g2
                        if channels > 3:
                            g3 = load(pixels, o + 5 * LANES)
                            color_dot_g = color_dot_g + g3 * c3
                            k3 = k3 + weight * g3
                        own = weight * color_dot_g
                        behind = load(pixels, o + LANES) - own
                        store(pixels, o + LANES, behind)
                        moves = both(greater(weight, zero), less_equal(uncapped, max_alpha))
                        g = select(moves, behind * (alpha * reciprocal(alpha - ONE)) + own, zero)
                        column_0 = column_0 + g
                        g_dy = g * dy
                        column_y = column_y + g_dy
                        column_yy = column_yy + g_dy * dy
                        if absgrad:
                            abs_u = abs_u + absolute(g * (dx * (TWO * A) + row_b[U(row_index)]))
                            abs_v = abs_v + absolute(g * (dx * B + TWO * C * dy))
                    column_x = column_0 * dx
                    m0 = m0 + column_0
                    mx = mx + column_x
                    my = my + column_y
                    mxx = mxx + column_x * dx
                    mxy = mxy + column_y * dx
                    myy = myy + column_yy
                slot = U(slot_of[U(k)])
                o = slot * U(size)
                first_sums = lane_sums_of_8(m0, mx, my, mxx, mxy, myy, k0, k1)
                if LANES == 8 and size >= 8:
                    store_anywhere(slots, o, first_sums)
                else:
                    store(row_b, 0, first_sums)
                    for j in range(U(min(size, 8))):
                        slots[o + j] = row_b[j]
                if channels > 2 or absgrad:
                    store(row_c, 0, lane_sums_of_4(k2, k3, abs_u, abs_v))
                    if channels > 2:
                        slots[o + U(8)] = row_c[0]
                    if channels > 3:
                        slots[o + U(9)] = row_c[1]
                    if absgrad:
                        slots[o + U(size - 2)] = row_c[2]
                        slots[o + U(size - 1)] = row_c[3]
                if end_early and (k - begin) % CHECK_EVERY == CHECK_EVERY - 1:
                    while first_row <= last_row and not row_alive(pixels, first_row * row, block):
                        first_row += 1
                    while last_row >= first_row and not row_alive(pixels, last_row * row, block):
                        last_row -= 1
            for k in range(end, tile_start[tile + 1]):
                o = U(slot_of[U(k)]) * U(size)
                for j in range(U(size)):
                    slots[o + j] = ZERO

    return blend_backward
