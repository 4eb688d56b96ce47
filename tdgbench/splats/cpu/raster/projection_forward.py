"""From Gaussians to records, LANES at a time: project, cull, colour, and list the tiles of each that can be seen.

Each kept Gaussian becomes one record of 16 floats (a cache line): u, v from its box's corner, then A, B, C and
log2(opacity), so that log2(alpha) = log2(opacity) + A dx² + B dx dy + C dy²; the opacity; the channels; and the box in
which alpha ≥ 1/255.
"""

from __future__ import annotations

import numpy as np
from numba import int64

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.harmonics import view_direction, write_basis
from tdgbench.splats.cpu.raster.limits import LOG2_MIN_ALPHA, LOOSE, MIN_ALPHA
from tdgbench.splats.cpu.raster.limits import REACH as REACH_LIMIT
from tdgbench.splats.cpu.raster.projection import (
    LOG2_E,
    along_axes,
    camera_point,
    clamped_ray,
    covariance_2d,
    deviations,
    exact_image_point,
    jacobian_rows,
    opacity_and_log2,
    rotation,
    screen_radius,
)
from tdgbench.splats.cpu.raster.records import (
    A_,
    B_,
    C_,
    CHANNELS,
    FIRST_X,
    LOG2_OPACITY,
    OPACITY,
    RADIUS,
    U_,
    V_,
)  # fmt: skip
from tdgbench.splats.cpu.raster.tiles import SLACK, TILE, list_tiles
from tdgbench.splats.cpu.simd.memory import aligned_floats, float_bits, gather, gather_3, load, store
from tdgbench.splats.cpu.simd.reductions import any_positive
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    divide,
    greater,
    greater_equal,
    is_nan,
    maximum,
    minimum,
    round_down,
    round_up,
    select,
    splat,
    square_root,
)

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
# Registers of one group of Gaussians, from the vector half of the kernel to its scalar half.
# 0 to 6 are as in a record; the channels stand from COLOR on.
VALID, KEEP, Z, REACH, WIDE, HIGH, SLOPE, CUT, DET, X0, X1, Y0, Y1 = range(7, 20)
COLOR, GROUP = 20, 24


@kernel(inline=True)
def write_colors(group, colors, rows, k, stride, column, channels, degree, mean, camera, basis):
    """Registers COLOR, COLOR + 1, … of the group: colours as given (degree −1) or from spherical harmonics."""
    if degree < 0:
        for c in range(channels):
            store(group, (COLOR + c) * LANES, gather(colors, rows, k, stride, column + c))
    else:
        x, y, z, _ = view_direction(mean, camera)
        write_basis(x, y, z, degree, basis)
        for c in range(channels):
            total = splat(HALF)
            for b in range((degree + 1) * (degree + 1)):
                total = total + load(basis, b * LANES) * gather(colors, rows, k, stride, column + b * channels + c)
            dark = greater(splat(ZERO), total)  # not so for NaN, which must be seen
            store(group, (COLOR + c) * LANES, select(dark, splat(ZERO), total))


@kernel()
def project_and_list(
    first, count, candidates, means, scales, quats, opacities, colors, layout, raw, channels, degree, camera, limits,
    depth_channel, first_pair, records, owners, pairs, depth_keys, order, seen, radii, means2d, tile_of_pair, counts,
):  # fmt: skip
    """Project candidates [first, first + count); kept ones become records from `first` on.

    layout: stride and first column of the five arrays (means, scales, quats, opacities, colours) as flat memory.
    owners[r] is a record's Gaussian; pairs[r] = first and last + 1 of its pairs, counted from first_pair. seen, radii,
    means2d: what was projected, from `first` on. counts = [records, pairs, projected,
    whether anything is NaN].
    """
    width, height = camera[22], camera[23]
    loose = limits[LOOSE] > ZERO
    tiles_x = (int64(width) + TILE - 1) // TILE
    group, basis = aligned_floats(GROUP * LANES), aligned_floats(16 * LANES)
    one, zero = splat(ONE), splat(ZERO)
    unknown = zero
    n_records, n_seen = first, first
    n_pairs = 0
    for k in range(first, first + count, LANES):
        mean = gather_3(means, candidates, k, layout[0], layout[1])
        s0, s1, s2 = deviations(scales, candidates, k, layout[2], layout[3], raw)
        r0, r1, r2, _, _ = rotation(quats, candidates, k, layout[4], layout[5])
        opacity, log2_opacity = opacity_and_log2(opacities, candidates, k, layout[6], layout[7], raw)
        x, y, z = camera_point(mean, camera)
        rz = divide(ONE, z)
        tx, ty = clamped_ray(x, y, rz, camera)
        ja, jb = jacobian_rows(tx, ty, rz, camera)
        p, q = along_axes(ja, r0, r1, r2), along_axes(jb, r0, r1, r2)
        p, q = (p[0] * s0, p[1] * s1, p[2] * s2), (q[0] * s0, q[1] * s1, q[2] * s2)
        a, b, c, det = covariance_2d(p, q, camera[21])
        # opacity and determinant carry what scales and quaternions hold
        unknown = select(is_nan(z), one, select(is_nan(det), one, select(is_nan(opacity), one, unknown)))
        valid = select(greater(z, splat(camera[19])), one, zero)
        valid = select(greater(splat(camera[20]), z), valid, zero)
        valid = select(greater(det, zero), valid, zero)
        valid = select(greater(splat(F(np.inf)), det), valid, zero)
        cut = log2_opacity - limits[LOG2_MIN_ALPHA]
        inverse = divide(ONE, det)
        wide = square_root(maximum(TWO / LOG2_E * cut * a, zero))
        high = square_root(maximum(TWO / LOG2_E * cut * c, zero))
        if loose:
            middle = HALF * (a + c)
            wide = limits[REACH_LIMIT] * square_root(middle + square_root(maximum(middle * middle - det, zero)))
            high = wide
        u, v = x * rz * camera[12] + camera[14], y * rz * camera[13] + camera[15]
        left, right = maximum(u - wide - (HALF + SLACK), zero), minimum(u + wide - (HALF - SLACK), splat(width - ONE))
        top, bottom = maximum(v - high - (HALF + SLACK), zero), minimum(v + high - (HALF - SLACK), splat(height - ONE))
        x0, x1, y0, y1 = round_up(left), round_down(right), round_up(top), round_down(bottom)
        keep = select(greater_equal(opacity, splat(limits[MIN_ALPHA])), valid, zero)
        keep = select(greater_equal(x1, x0), keep, zero)
        keep = select(greater_equal(y1, y0), keep, zero)
        store(group, KEEP * LANES, keep)
        store(group, X0 * LANES, x0)
        store(group, X1 * LANES, x1)
        store(group, Y0 * LANES, y0)
        store(group, Y1 * LANES, y1)
        store(group, U_ * LANES, u)
        store(group, V_ * LANES, v)
        store(group, A_ * LANES, -HALF * LOG2_E * c * inverse)
        store(group, B_ * LANES, LOG2_E * b * inverse)
        store(group, C_ * LANES, -HALF * LOG2_E * a * inverse)
        store(group, LOG2_OPACITY * LANES, log2_opacity)
        store(group, OPACITY * LANES, opacity)
        store(group, VALID * LANES, valid)
        store(group, Z * LANES, z)
        store(group, REACH * LANES, screen_radius(a, c, det, u, v, camera))
        store(group, WIDE * LANES, wide)
        store(group, HIGH * LANES, high)
        store(group, SLOPE * LANES, divide(b * wide, a))
        store(group, CUT * LANES, cut)
        store(group, DET * LANES, det)
        write_colors(
            group, colors, candidates, k, layout[8], layout[9], channels, degree, mean, camera, basis
        )  # fmt: skip
        for lane in range(min(LANES, first + count - k)):
            i = U(lane)
            if not (group[U(VALID * LANES) + i] > ZERO):
                continue
            u, v = group[U(U_ * LANES) + i], group[U(V_ * LANES) + i]
            at = U(n_seen)
            seen[at] = candidates[U(k) + i]
            radii[at] = np.int32(group[U(REACH * LANES) + i])
            means2d[at, U(0)], means2d[at, U(1)] = u, v
            n_seen += 1
            if not (group[U(KEEP * LANES) + i] > ZERO):
                continue
            hw, hh = group[U(WIDE * LANES) + i], group[U(HIGH * LANES) + i]
            x0_, x1_ = int64(group[U(X0 * LANES) + i]), int64(group[U(X1 * LANES) + i])
            y0_, y1_ = int64(group[U(Y0 * LANES) + i]), int64(group[U(Y1 * LANES) + i])
            A, B, C = group[U(A_ * LANES) + i], group[U(B_ * LANES) + i], group[U(C_ * LANES) + i]
            before = n_pairs
            n_pairs = list_tiles(
                n_pairs, u, v, A, B, C, group[U(DET * LANES) + i], group[U(CUT * LANES) + i], hw, hh,
                group[U(SLOPE * LANES) + i], x0_, x1_, y0_, y1_, loose, tiles_x, tile_of_pair,
            )  # fmt: skip
            if n_pairs == before:
                continue
            r = U(n_records)
            for j in range(U(A_), U(7)):
                records[r, j] = group[j * U(LANES) + i]
            at_mean = U(candidates[U(k) + i]) * U(layout[0]) + U(layout[1])
            exact_u, exact_v = exact_image_point(means[at_mean], means[at_mean + U(1)], means[at_mean + U(2)], camera)
            records[r, U(U_)], records[r, U(V_)] = F(exact_u - x0_), F(exact_v - y0_)
            for c in range(U(channels)):
                records[r, U(CHANNELS) + c] = group[(U(COLOR) + c) * U(LANES) + i]
            if depth_channel:
                records[r, U(CHANNELS + channels)] = group[U(Z * LANES) + i]
            records[r, U(RADIUS)] = F(radii[at])
            for j in range(U(4)):
                records[r, U(FIRST_X) + j] = group[(U(X0) + j) * U(LANES) + i]
            pairs[r, U(0)], pairs[r, U(1)] = first_pair + before, first_pair + n_pairs
            depth_keys[r] = float_bits(group[U(Z * LANES) + i])
            order[r] = n_records
            owners[r] = seen[at]
            n_records += 1
    counts[0] = n_records - first
    counts[1] = n_pairs
    counts[2] = n_seen - first
    counts[3] = any_positive(unknown)
