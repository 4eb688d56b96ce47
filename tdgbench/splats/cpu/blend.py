"""Alpha blending of a tile, front to back (3DGS, eq. 3), LANES pixels of a row at a time.

    image_c = Σ_k c_k w_k + T background_c,  w_k = alpha_k T_k,  T_{k+1} = T_k (1 − alpha_k)

alpha is capped at max_alpha (0.99) and skipped below min_alpha (1/255); a pixel stops before the Gaussian that would
take T below min_transmittance (1e-4).
There is no branch for stopped pixels: their T is kept with its sign bit set, which makes every further weight zero.
"""

from __future__ import annotations

import functools

import numpy as np
from numba import int64

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.limits import END_EARLY, LOG2_MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE
from tdgbench.splats.cpu.memory import aligned_floats, load, prefetch_row, store, take_next
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
from tdgbench.splats.cpu.reductions import any_positive
from tdgbench.splats.cpu.simd import (
    LANES,
    exp2,
    exp2_rough,
    greater_equal,
    lane_index,
    maximum,
    minimum,
    negative_abs,
    select,
    splat,
)
from tdgbench.splats.cpu.tiles import TILE

F, U = np.float32, np.uint64
ZERO, HALF, ONE, DEAD = F(0), F(0.5), F(1), F(-0.0)
BLOCKS = TILE // LANES  # registers per row of a tile
LOOK_AHEAD = 4
CHECK_EVERY = 16


@kernel(inline=True)
def row_alive(pixels, offset, stride):
    """True while any pixel of a row of the tile still lets light through."""
    alive = any_positive(load(pixels, offset))
    if BLOCKS == 2:
        alive = alive or any_positive(load(pixels, offset + stride))
    return alive


@functools.cache
def make_blend(colors: int, depth: bool, rough_exp: bool):
    """The forward kernel for `colors` channels, and depth as one more; 1 to 4 in all."""
    channels = colors + depth
    block = (1 + channels) * LANES  # per register: T, then the channels
    row = BLOCKS * block

    @kernel()
    def blend(counter, width, height, records, tile_start, gaussian_of, background, limits,
              image, depth_map, transmittance, reached):  # fmt: skip
        """Blend tiles until none is left. reached[tile]: how many of its Gaussians were looked at."""
        tiles_x = (width + TILE - 1) // TILE
        n_tiles = tile_start.shape[0] - 1
        max_alpha, log2_min_alpha = limits[MAX_ALPHA], limits[LOG2_MIN_ALPHA]
        min_transmittance, end_early = limits[MIN_TRANSMITTANCE], limits[END_EARLY] > ZERO
        pixels = aligned_floats(TILE * row + 2 * TILE)
        row_b = pixels[TILE * row :]
        row_c = row_b[TILE:]
        zero = splat(ZERO)
        centre = lane_index() + HALF
        while True:
            tile = take_next(counter)
            if tile >= n_tiles:
                break
            left = (tile % tiles_x) * TILE
            top = (tile // tiles_x) * TILE
            for y in range(TILE):
                for part in range(BLOCKS):
                    o = y * row + part * block
                    for i in range(LANES):
                        inside = left + part * LANES + i < width and top + y < height
                        pixels[U(o + i)] = ONE if inside else DEAD
                    for i in range(LANES, block):
                        pixels[U(o + i)] = ZERO
            begin, end = tile_start[tile], tile_start[tile + 1]
            first_row, last_row = 0, TILE - 1
            k = begin
            done = end
            while k < end:
                i = U(gaussian_of[U(k)])
                if k + LOOK_AHEAD < end:
                    prefetch_row(records, U(gaussian_of[U(k + LOOK_AHEAD)]))
                y0 = max(int64(records[i, FIRST_Y]) - top, first_row)
                y1 = min(int64(records[i, LAST_Y]) - top, last_row)
                dx0 = (F(left) - records[i, FIRST_X]) - records[i, U_]
                dy0 = (F(top) - records[i, FIRST_Y]) - records[i, V_]
                for h in range(0, TILE, LANES):
                    dy = centre + (dy0 + F(h))
                    store(row_b, h, dy * records[i, B_])
                    store(row_c, h, dy * dy * records[i, C_])
                c0 = splat(records[i, CHANNELS])
                c1 = splat(records[i, CHANNELS + 1])
                c2 = splat(records[i, CHANNELS + 2])
                c3 = splat(records[i, CHANNELS + 3])
                for part in range(BLOCKS):
                    x = left + part * LANES
                    if BLOCKS == 2 and (records[i, LAST_X] < F(x) or records[i, FIRST_X] >= F(x + LANES)):
                        continue
                    dx = centre + (dx0 + F(part * LANES))
                    along_x = dx * dx * records[i, A_] + records[i, LOG2_OPACITY]
                    for y in range(y0, y1 + 1):
                        o = y * row + part * block
                        log2_alpha = dx * row_b[U(y)] + (along_x + row_c[U(y)])
                        alpha = minimum(exp2_rough(log2_alpha) if rough_exp else exp2(log2_alpha), max_alpha)
                        t = load(pixels, o)
                        t_alive = maximum(t, zero)
                        weight = select(greater_equal(log2_alpha, log2_min_alpha), alpha * t_alive, zero)
                        t_next = t_alive - weight
                        goes_on = greater_equal(t_next, min_transmittance)
                        store(pixels, o, select(goes_on, t_next, negative_abs(t)))
                        weight = select(goes_on, weight, zero)
                        store(pixels, o + LANES, load(pixels, o + LANES) + weight * c0)
                        if channels > 1:
                            store(pixels, o + 2 * LANES, load(pixels, o + 2 * LANES) + weight * c1)
                        if channels > 2:
                            store(pixels, o + 3 * LANES, load(pixels, o + 3 * LANES) + weight * c2)
                        if channels > 3:
                            store(pixels, o + 4 * LANES, load(pixels, o + 4 * LANES) + weight * c3)
                k += 1
                if end_early and (k - begin) % CHECK_EVERY == 0:
                    while first_row <= last_row and not row_alive(pixels, first_row * row, block):
                        first_row += 1
                    while last_row >= first_row and not row_alive(pixels, last_row * row, block):
                        last_row -= 1
                    if first_row > last_row:
                        done = k
                        break
            reached[tile] = done - begin
            for y in range(U(min(TILE, height - top))):
                for x in range(U(min(TILE, width - left))):
                    o = y * U(row) + (x // U(LANES)) * U(block) + x % U(LANES)
                    t_left = abs(pixels[o])
                    transmittance[U(top) + y, U(left) + x] = t_left
                    for c in range(U(colors)):
                        light = pixels[o + U(LANES) * (c + U(1))]
                        image[U(top) + y, U(left) + x, c] = light + t_left * background[c]
                    if depth:
                        depth_map[U(top) + y, U(left) + x] = pixels[o + U(LANES * channels)]

    return blend
