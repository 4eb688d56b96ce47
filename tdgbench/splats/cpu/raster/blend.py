"""Alpha blending of a tile, front to back (3DGS, eq. 3), a block of LANES pixels at a time.

    image_c = Σ_k c_k w_k + T background_c,  w_k = alpha_k T_k,  T_{k+1} = T_k (1 − alpha_k)

alpha is capped at max_alpha (0.99) and skipped below min_alpha (1/255); a pixel stops before the Gaussian that would
take T below min_transmittance (1e-4).
There is no branch for stopped pixels: their T is kept with its sign bit set, which makes every further weight zero.
"""

from __future__ import annotations

import functools

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blocks import (
    ALL,
    BLOCKS,
    NONE,
    OWN,
    T,
    form_of,
    log2_alpha_in,
    lowest,
    pixel_of,
    within_reach,
    write_centres,
    write_transmittance,
)
from tdgbench.splats.cpu.raster.limits import END_EARLY, LOG2_MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE
from tdgbench.splats.cpu.raster.records import CHANNELS
from tdgbench.splats.cpu.raster.tiles import TILE
from tdgbench.splats.cpu.simd.memory import aligned_floats, load, prefetch_row, store, take_next
from tdgbench.splats.cpu.simd.powers import exp2_in_memory
from tdgbench.splats.cpu.simd.reductions import any_bit, any_positive
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    greater_equal,
    maximum,
    minimum,
    negative_abs,
    select,
    splat,
)

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)
TOGETHER = 16  # Gaussians whose blocks are found before they are blended; then stopped blocks are looked for
LOOK_AHEAD = 16


@kernel(inline=True)
def still_alive(alive, pixels, size):
    """Those of the blocks `alive` in which some pixel still lets light through."""
    left = alive
    while left != NONE:
        block = lowest(left)
        left &= left - U(1)
        if not any_positive(load(pixels, block * U(size) + T)):
            alive &= ~(U(1) << block)
    return alive


@functools.cache
def make_blend(colors: int, depth: bool):
    """The forward kernel for `colors` channels, and depth as one more; 1 to 4 in all."""
    channels = colors + depth
    size = (3 + channels) * LANES  # of a block: x, y, T, then the channels

    @kernel(variant=f"{colors}_depth" if depth else f"{colors}")
    def blend(counter, width, height, records, tile_start, gaussian_of, background, limits, powers, grid,
              image, depth_map, transmittance, reached, lit):  # fmt: skip
        """Blend tiles until none is left.

        reached[tile]: how many of its Gaussians were looked at; lit: in which blocks each of those has any weight.
        """
        tiles_x = (width + TILE - 1) // TILE
        n_tiles = tile_start.shape[0] - 1
        max_alpha, log2_min_alpha = limits[MAX_ALPHA], limits[LOG2_MIN_ALPHA]
        min_transmittance, end_early = limits[MIN_TRANSMITTANCE], limits[END_EARLY] > ZERO
        pixels = aligned_floats(BLOCKS * size)
        write_centres(pixels, size, grid)
        zero = splat(ZERO)
        while True:
            tile = take_next(counter)
            if tile >= n_tiles:
                break
            left = (tile % tiles_x) * TILE
            top = (tile // tiles_x) * TILE
            write_transmittance(pixels, size, width - left, height - top)
            for block in range(U(BLOCKS)):
                for c in range(U(channels)):
                    store(pixels, block * U(size) + OWN + U(LANES) * c, zero)
            alive = ALL
            begin, end = tile_start[tile], tile_start[tile + 1]
            done = end
            for first in range(begin, end, TOGETHER):
                last = min(first + TOGETHER, end)
                for k in range(U(first), U(last)):
                    i = U(gaussian_of[k])
                    ahead = min(k + U(LOOK_AHEAD), U(end - 1))
                    prefetch_row(records, U(gaussian_of[ahead]))
                    lit[k] = within_reach(grid, form_of(records, i, left, top), log2_min_alpha) & alive
                for k in range(U(first), U(last)):
                    blocks = U(lit[k])
                    i = U(gaussian_of[k])
                    form = form_of(records, i, left, top)
                    c0 = splat(records[i, CHANNELS])
                    c1 = splat(records[i, CHANNELS + 1])
                    c2 = splat(records[i, CHANNELS + 2])
                    c3 = splat(records[i, CHANNELS + 3])
                    own = NONE
                    while blocks != NONE:
                        block = lowest(blocks)
                        blocks &= blocks - U(1)
                        o = block * U(size)
                        log2_alpha = log2_alpha_in(pixels, o, form)
                        alpha = minimum(exp2_in_memory(log2_alpha, powers), max_alpha)
                        t = load(pixels, o + T)
                        t_alive = maximum(t, zero)
                        weight = select(greater_equal(log2_alpha, log2_min_alpha), alpha * t_alive, zero)
                        own |= U(any_bit(weight)) << block
                        t_next = t_alive - weight
                        goes_on = greater_equal(t_next, min_transmittance)
                        store(pixels, o + T, select(goes_on, t_next, negative_abs(t)))
                        weight = select(goes_on, weight, zero)
                        o0, o1, o2, o3 = o + OWN, o + OWN + U(LANES), o + OWN + U(2 * LANES), o + OWN + U(3 * LANES)
                        store(pixels, o0, load(pixels, o0) + weight * c0)
                        if channels > 1:
                            store(pixels, o1, load(pixels, o1) + weight * c1)
                        if channels > 2:
                            store(pixels, o2, load(pixels, o2) + weight * c2)
                        if channels > 3:
                            store(pixels, o3, load(pixels, o3) + weight * c3)
                    lit[k] = own
                if end_early:
                    alive = still_alive(alive, pixels, size)
                    if alive == NONE:
                        done = last
                        break
            reached[tile] = done - begin
            for block in range(U(BLOCKS)):
                for lane in range(U(LANES)):
                    y, x = pixel_of(block, lane, left, top)
                    if y < U(height) and x < U(width):
                        o = block * U(size) + lane
                        t_left = abs(pixels[o + T])
                        transmittance[y, x] = t_left
                        for c in range(U(colors)):
                            image[y, x, c] = pixels[o + OWN + U(LANES) * c] + t_left * background[c]
                        if depth:
                            depth_map[y, x] = pixels[o + OWN + U(LANES * colors)]

    return blend
