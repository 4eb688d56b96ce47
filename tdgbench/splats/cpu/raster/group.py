"""A group of LANES Gaussians on its way to splats: projected as registers, then read lane by lane.

`group` (GROUP · LANES,) float32 holds the registers; `i` is an unsigned lane.
"""

from __future__ import annotations

import numpy as np
from numba import int64

from tdgbench.splats.columns import COLORS_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.parameters import LOG2_E, gathered_column, opacity_and_log2
from tdgbench.splats.cpu.raster.projection import exact_image_point, footprint_of, screen_radius
from tdgbench.splats.cpu.raster.sh_registers import view_direction, write_basis
from tdgbench.splats.cpu.raster.tiles import SLACK, Ellipse, PixelBox
from tdgbench.splats.cpu.raster.types import (
    A_,
    B_,
    C_,
    CHANNELS,
    FIRST_X,
    FIRST_Y,
    FLOATS,
    LAST_X,
    LAST_Y,
    LOG2_OPACITY,
    OPACITY,
    RADIUS,
    U_,
    V_,
)
from tdgbench.splats.cpu.simd.memory import load, store, store_whole, turn_block
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    broadcast,
    divide,
    greater,
    greater_equal,
    is_nan,
    maximum,
    minimum,
    narrow,
    round_down,
    round_up,
    select,
    square_root,
    widen,
)

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
# Registers of a group. 0 to 15 are the columns of a splat.
VALID, KEEP, Z, WIDE, HIGH, SLOPE, CUT, DET, U_SINGLE, V_SINGLE, GROUP = range(FLOATS, FLOATS + 11)


@kernel(inline=True)
def project_group(group, gathered, raw, camera, limits, has_nan):
    """Write the registers of the Gaussians in `gathered`, without colours; returns their means and has_nan.

    has_nan: a register, above zero in lanes that met a NaN. raw: before activation.
    """
    footprint = footprint_of(gathered, raw, camera)
    opacity, log2_opacity = opacity_and_log2(gathered, raw)
    (x, y, z), (a, b, c), det = footprint.point, footprint.covariance, footprint.det
    one, zero = broadcast(ONE), broadcast(ZERO)
    # opacity and determinant carry what scales and quaternions hold
    has_nan = select(is_nan(z), one, select(is_nan(det), one, select(is_nan(opacity), one, has_nan)))
    valid = select(greater(z, broadcast(camera.near)), one, zero)
    valid = select(greater(broadcast(camera.far), z), valid, zero)
    valid = select(greater(det, zero), valid, zero)
    valid = select(greater(broadcast(F(np.inf)), det), valid, zero)
    keep = select(greater_equal(opacity, broadcast(limits.min_alpha)), valid, zero)
    u, v = x * footprint.rz * camera.fx + camera.cx, y * footprint.rz * camera.fy + camera.cy
    cut = log2_opacity - limits.log2_min_alpha
    wide, high = half_sides(a, c, cut)
    inverse = divide(ONE, det)
    store(group, U_SINGLE * LANES, u)
    store(group, V_SINGLE * LANES, v)
    store(group, A_ * LANES, -HALF * LOG2_E * c * inverse)
    store(group, B_ * LANES, LOG2_E * b * inverse)
    store(group, C_ * LANES, -HALF * LOG2_E * a * inverse)
    store(group, LOG2_OPACITY * LANES, log2_opacity)
    store(group, OPACITY * LANES, opacity)
    store(group, VALID * LANES, valid)
    store(group, KEEP * LANES, write_box(group, u, v, wide, high, keep, camera))
    store(group, Z * LANES, z)
    store(group, RADIUS * LANES, screen_radius(a, c, det, u, v, camera))
    store(group, WIDE * LANES, wide)
    store(group, HIGH * LANES, high)
    store(group, SLOPE * LANES, divide(b * wide, a))
    store(group, CUT * LANES, cut)
    store(group, DET * LANES, det)
    exact_u, exact_v = exact_image_point(footprint.mean, camera)
    store(group, U_ * LANES, narrow(exact_u - widen(load(group, FIRST_X * LANES))))
    store(group, V_ * LANES, narrow(exact_v - widen(load(group, FIRST_Y * LANES))))
    return footprint.mean, has_nan


@kernel(inline=True)
def half_sides(a, c, cut):
    """Half the width and height, px, of the ellipse in which log2(alpha) is at most `cut` below that of the centre."""
    wide = square_root(maximum(TWO / LOG2_E * cut * a, broadcast(ZERO)))
    high = square_root(maximum(TWO / LOG2_E * cut * c, broadcast(ZERO)))
    return wide, high


@kernel(inline=True)
def write_box(group, u, v, wide, high, keep, camera):
    """Write the first and last column and row of pixels of a box; returns `keep`, with zero for an empty one."""
    zero = broadcast(ZERO)
    left = maximum(u - wide - (HALF + SLACK), zero)
    right = minimum(u + wide - (HALF - SLACK), broadcast(camera.width - ONE))
    top = maximum(v - high - (HALF + SLACK), zero)
    bottom = minimum(v + high - (HALF - SLACK), broadcast(camera.height - ONE))
    x0, x1, y0, y1 = round_up(left), round_down(right), round_up(top), round_down(bottom)
    store(group, FIRST_X * LANES, x0)
    store(group, LAST_X * LANES, x1)
    store(group, FIRST_Y * LANES, y0)
    store(group, LAST_Y * LANES, y1)
    return select(greater_equal(y1, y0), select(greater_equal(x1, x0), keep, zero), zero)


@kernel(inline=True)
def write_channels(group, gathered, channels, mean, camera, basis):
    """Write the registers of the channels: colours as given (degree −1) or from spherical harmonics, and depth.

    basis (16 · LANES,) float32 is scratch.
    """
    if channels.degree < 0:
        for c in range(channels.colors):
            store(group, (CHANNELS + c) * LANES, gathered_column(gathered, COLORS_AT + c))
    else:
        x, y, z, _ = view_direction(mean, camera)
        write_basis(x, y, z, channels.degree, basis)
        for c in range(channels.colors):
            total = broadcast(HALF)
            for b in range((channels.degree + 1) * (channels.degree + 1)):
                total = total + load(basis, b * LANES) * gathered_column(gathered, COLORS_AT + b * channels.colors + c)
            dark = greater(broadcast(ZERO), total)  # not so for NaN, which must show
            store(group, (CHANNELS + c) * LANES, select(dark, broadcast(ZERO), total))
    if channels.depth:
        store(group, (CHANNELS + channels.colors) * LANES, load(group, Z * LANES))


@kernel(inline=True)
def write_boxes(group, boxes):
    """Write the boxes to `boxes` (4 · LANES,) int32: first and last column and row of all lanes, px."""
    store_whole(boxes, 0, load(group, FIRST_X * LANES))
    store_whole(boxes, LANES, load(group, LAST_X * LANES))
    store_whole(boxes, 2 * LANES, load(group, FIRST_Y * LANES))
    store_whole(boxes, 3 * LANES, load(group, LAST_Y * LANES))


@kernel(inline=True)
def box_of(boxes, i):
    """Box of lane i."""
    return PixelBox(
        int64(boxes[i]), int64(boxes[U(LANES) + i]), int64(boxes[U(2 * LANES) + i]), int64(boxes[U(3 * LANES) + i])
    )


@kernel(inline=True)
def ellipse_of(group, i):
    """Ellipse of lane i."""
    return Ellipse(
        group[U(U_SINGLE * LANES) + i],
        group[U(V_SINGLE * LANES) + i],
        group[U(A_ * LANES) + i],
        group[U(B_ * LANES) + i],
        group[U(C_ * LANES) + i],
        group[U(DET * LANES) + i],
        group[U(CUT * LANES) + i],
        group[U(WIDE * LANES) + i],
        group[U(HIGH * LANES) + i],
        group[U(SLOPE * LANES) + i],
    )


@kernel(inline=True)
def turn_splats(group, rows):
    """rows (FLOATS · LANES,) float32 = the splats of all lanes, one after the other."""
    for c in range(0, FLOATS, LANES):
        turn_block(group, c * LANES, LANES, rows, c, FLOATS)


@kernel(inline=True)
def copy_splat(rows, i, splats, r):
    """Row r of flat splats (n · FLOATS,) = the splat of lane i in `rows`."""
    for c in range(0, FLOATS, LANES):
        store(splats, r * U(FLOATS) + U(c), load(rows, i * U(FLOATS) + U(c)))
