"""Alpha blending of a tile's Gaussians from near to far, and its gradient; sums have a fixed order, without atomics.

Kernels are made for a number of features. In the backward pass the threads of a block share the pixels of a tile; they
add up each Gaussian's gradient in a block-wise reduction and write it to the slot of the pair.
"""

from functools import cache
from typing import NamedTuple

import warp as wp

from tdgbench.splats.warp.arrays import TILE, TILE_PIXELS, Splats2D, TilePairs, WarpView

GEOMETRY = wp.constant(6)  # columns of a gradient before those of the features: mean (2), shape (3), opacity


class BackwardBlend(NamedTuple):
    """Kernel with a block of `lanes` threads per tile, which writes a row of gradients per pair."""

    kernel: wp.Kernel
    row: type  # vector of `columns` floats
    columns: int


@wp.func
def offset(center: wp.vec2, shape: wp.vec3, x: int, y: int):
    """Return the sheared offset dx − k dy, and dy, of a pixel from a Gaussian's centre, px."""
    dy = float(y) + 0.5 - center[1]
    return float(x) + 0.5 - center[0] - shape[1] * dy, dy


@wp.func
def falloff(shape: wp.vec3, u: float, dy: float):
    """Return exp(−(q u² + v dy²) / 2)."""
    return wp.exp(-0.5 * (shape[0] * u * u + shape[2] * dy * dy))


@cache
def forward_blend(features: int) -> wp.Kernel:
    """Return the kernel for a number of features, with a thread per pixel."""
    F, vec_f = features, wp.types.vector(length=features, dtype=float)

    @wp.kernel(enable_backward=False, module=f"{__name__}_forward_{features}")
    def forward(
        v: WarpView, projected: Splats2D, pairs: TilePairs, opacities: wp.array(dtype=float),
        light: wp.array3d(dtype=float), transmittance: wp.array2d(dtype=float), last: wp.array2d(dtype=int),
    ):  # fmt: skip
        """Blend a pixel: light (H, W, F), transmittance and the last pair that it blended, or −1."""
        i = wp.tid()
        tile = i // TILE_PIXELS
        x = (tile % v.tiles_x) * TILE + i % TILE
        y = (tile // v.tiles_x) * TILE + (i % TILE_PIXELS) // TILE
        if x >= v.width or y >= v.height:
            return
        remaining, total, end = float(1.0), vec_f(), int(-1)
        for s in range(pairs.starts[tile], pairs.starts[tile + 1]):
            g = pairs.owners[pairs.slots[s]]
            u, dy = offset(projected.means2d[g], projected.shapes[g], x, y)
            alpha = wp.min(opacities[g] * falloff(projected.shapes[g], u, dy), v.max_alpha)
            if alpha >= v.min_alpha:
                after = remaining * (1.0 - alpha)
                if after < v.min_transmittance:
                    break
                for f in range(F):
                    total[f] += alpha * remaining * projected.features[g, f]
                remaining, end = after, s
        if projected.broken[0] != 0:
            remaining, end = wp.nan, -1
        for f in range(F):
            light[y, x, f] = total[f] + 0.0 * remaining
        transmittance[y, x] = remaining
        last[y, x] = end

    return forward


@cache
def backward_blend(features: int, lanes: int, absolute: bool) -> BackwardBlend:
    """Return the kernel for a number of features and threads per tile; absolute: gradients also have |by mean|."""
    F, P, columns = features, TILE_PIXELS // lanes, GEOMETRY + features + 2 * absolute
    row_type = wp.types.vector(length=columns, dtype=float)
    vec_p, vec_p_int = wp.types.vector(length=P, dtype=float), wp.types.vector(length=P, dtype=int)
    module = f"{__name__}_{F}_{lanes}" + "_absolute" * absolute

    @wp.kernel(enable_backward=False, module=module)
    def backward(
        v: WarpView, projected: Splats2D, pairs: TilePairs, opacities: wp.array(dtype=float),
        transmittance: wp.array2d(dtype=float), last: wp.array2d(dtype=int), by_light: wp.array3d(dtype=float),
        by_transmittance: wp.array2d(dtype=float), rows: wp.array(dtype=row_type),
    ):  # fmt: skip
        """Go through a tile from far to near, and write each pair's gradient to the row of its slot."""
        tile, lane = wp.tid()
        left, top = (tile % v.tiles_x) * TILE, (tile // v.tiles_x) * TILE
        after = vec_p()  # transmittance behind the Gaussian
        behind = vec_p()  # d loss / d log of it: what lies behind
        ends, farthest = vec_p_int(), int(-1)
        for k in range(P):
            pixel = lane + k * lanes
            x, y = left + pixel % TILE, top + pixel // TILE
            ends[k] = -1
            if x < v.width and y < v.height:
                after[k] = transmittance[y, x]
                ends[k] = last[y, x]
                behind[k] = after[k] * by_transmittance[y, x]
            farthest = wp.max(farthest, ends[k])
        s = wp.tile_max(wp.tile(farthest))[0]
        while s >= pairs.starts[tile]:
            slot = pairs.slots[s]
            g = pairs.owners[slot]
            shape, row = projected.shapes[g], row_type()
            for k in range(P):
                if s <= ends[k]:
                    pixel = lane + k * lanes
                    x, y = left + pixel % TILE, top + pixel // TILE
                    u, dy = offset(projected.means2d[g], shape, x, y)
                    weight = falloff(shape, u, dy)
                    free = opacities[g] * weight
                    alpha = wp.min(free, v.max_alpha)
                    if alpha >= v.min_alpha:
                        inverse = 1.0 / (1.0 - alpha)
                        after[k] = after[k] * inverse  # now that before the Gaussian
                        by_weight = float(0.0)
                        for f in range(F):
                            by_weight += projected.features[g, f] * by_light[y, x, f]
                            row[GEOMETRY + f] += alpha * after[k] * by_light[y, x, f]
                        by_alpha = after[k] * by_weight - inverse * behind[k]
                        behind[k] += alpha * after[k] * by_weight
                        if free <= v.max_alpha:
                            by_power = by_alpha * free
                            by_x = by_power * shape[0] * u
                            by_y = by_power * (shape[2] * dy - shape[0] * shape[1] * u)
                            row[0] += by_x
                            row[1] += by_y
                            row[2] -= 0.5 * by_power * u * u
                            row[3] += by_x * dy
                            row[4] -= 0.5 * by_power * dy * dy
                            row[5] += by_alpha * weight
                            if wp.static(absolute):
                                row[GEOMETRY + F] += wp.abs(by_x)
                                row[GEOMETRY + F + 1] += wp.abs(by_y)
            wp.tile_store(rows, wp.tile_sum(wp.tile(row, preserve_type=True)), offset=slot)
            s -= 1

    return BackwardBlend(backward, row_type, columns)
