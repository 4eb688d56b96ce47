"""A group of LANES Gaussians on its way to splats: projected as registers, then read lane by lane.

`group` (GROUP · LANES,) float32 holds the registers; `i` is an unsigned lane.
"""

from __future__ import annotations

import numpy as np
from numba import int64

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.harmonics import view_direction, write_basis
from tdgbench.splats.cpu.raster.parameters import LOG2_E, column, opacity_and_log2
from tdgbench.splats.cpu.raster.projection import footprint_of, screen_radius
from tdgbench.splats.cpu.raster.splat import A_, B_, C_, CHANNELS, FIRST_X, LOG2_OPACITY, OPACITY, U_, V_
from tdgbench.splats.cpu.raster.tiles import SLACK, Box, Ellipse
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    broadcast,
    divide,
    greater,
    greater_equal,
    is_nan,
    maximum,
    minimum,
    round_down,
    round_up,
    select,
    square_root,
)

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
# Registers of a group. 0 to 6 are as in a splat; the channels begin at COLOR.
VALID, KEEP, Z, SCREEN_RADIUS, WIDE, HIGH, SLOPE, CUT, DET, X0, X1, Y0, Y1 = range(7, 20)
COLOR, GROUP = 20, 24


@kernel(inline=True)
def project_group(group, rows, k, parameters, camera, limits, has_nan):
    """Write the registers of the Gaussians rows[k …], without colours; returns their means and has_nan.

    has_nan: a register, above zero in lanes that met a NaN.
    """
    footprint = footprint_of(parameters, rows, k, camera)
    opacity, log2_opacity = opacity_and_log2(parameters.opacities, rows, k, parameters.raw)
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
    wide, high = half_sides(a, c, det, cut, limits)
    inverse = divide(ONE, det)
    store(group, U_ * LANES, u)
    store(group, V_ * LANES, v)
    store(group, A_ * LANES, -HALF * LOG2_E * c * inverse)
    store(group, B_ * LANES, LOG2_E * b * inverse)
    store(group, C_ * LANES, -HALF * LOG2_E * a * inverse)
    store(group, LOG2_OPACITY * LANES, log2_opacity)
    store(group, OPACITY * LANES, opacity)
    store(group, VALID * LANES, valid)
    store(group, KEEP * LANES, write_box(group, u, v, wide, high, keep, camera))
    store(group, Z * LANES, z)
    store(group, SCREEN_RADIUS * LANES, screen_radius(a, c, det, u, v, camera))
    store(group, WIDE * LANES, wide)
    store(group, HIGH * LANES, high)
    store(group, SLOPE * LANES, divide(b * wide, a))
    store(group, CUT * LANES, cut)
    store(group, DET * LANES, det)
    return footprint.mean, has_nan


@kernel(inline=True)
def half_sides(a, c, det, cut, limits):
    """Half the width and height, px, of the box in which log2(alpha) may be `cut` below that of the centre.

    Of the ellipse where alpha ≥ min_alpha, or with `loose` of the square around the cutoff.
    """
    wide = square_root(maximum(TWO / LOG2_E * cut * a, broadcast(ZERO)))
    high = square_root(maximum(TWO / LOG2_E * cut * c, broadcast(ZERO)))
    if limits.loose:
        middle = HALF * (a + c)
        longest = middle + square_root(maximum(middle * middle - det, broadcast(ZERO)))
        wide = limits.cutoff * square_root(longest)
        high = wide
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
    store(group, X0 * LANES, x0)
    store(group, X1 * LANES, x1)
    store(group, Y0 * LANES, y0)
    store(group, Y1 * LANES, y1)
    return select(greater_equal(y1, y0), select(greater_equal(x1, x0), keep, zero), zero)


@kernel(inline=True)
def write_colors(group, colors, rows, k, channels, mean, camera, basis):
    """Write the registers from COLOR on: colours as given (degree −1) or from spherical harmonics.

    basis (16 · LANES,) float32 is scratch.
    """
    if channels.degree < 0:
        for c in range(channels.colors):
            store(group, (COLOR + c) * LANES, column(colors, rows, k, c))
    else:
        x, y, z, _ = view_direction(mean, camera)
        write_basis(x, y, z, channels.degree, basis)
        for c in range(channels.colors):
            total = broadcast(HALF)
            for b in range((channels.degree + 1) * (channels.degree + 1)):
                total = total + load(basis, b * LANES) * column(colors, rows, k, b * channels.colors + c)
            dark = greater(broadcast(ZERO), total)  # not so for NaN, which must show
            store(group, (COLOR + c) * LANES, select(dark, broadcast(ZERO), total))


@kernel(inline=True)
def box_of(group, i):
    """Box of lane i."""
    return Box(
        int64(group[U(X0 * LANES) + i]),
        int64(group[U(X1 * LANES) + i]),
        int64(group[U(Y0 * LANES) + i]),
        int64(group[U(Y1 * LANES) + i]),
    )


@kernel(inline=True)
def ellipse_of(group, i):
    """Ellipse of lane i."""
    return Ellipse(
        group[U(U_ * LANES) + i],
        group[U(V_ * LANES) + i],
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
def write_splat(splats, r, group, i, channels):
    """Row r of splats (n, 16) from lane i, but for mean and radius."""
    for j in range(U(A_), U(7)):
        splats[r, j] = group[j * U(LANES) + i]
    for c in range(U(channels.colors)):
        splats[r, U(CHANNELS) + c] = group[(U(COLOR) + c) * U(LANES) + i]
    if channels.depth:
        splats[r, U(CHANNELS + channels.colors)] = group[U(Z * LANES) + i]
    for j in range(U(4)):
        splats[r, U(FIRST_X) + j] = group[(U(X0) + j) * U(LANES) + i]
