"""From Gaussians to records, LANES at a time: project, cull, colour, and list the tiles of each that can be seen.

Each kept Gaussian becomes one record of 16 floats (a cache line): u, v, then A, B, C and log2(opacity), so that
log2(alpha) = log2(opacity) + A dx² + B dx dy + C dy²; the opacity; and the channels. The box in which alpha ≥ 1/255 is
kept beside it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import int64

from tdgbench.splats.cpu.harmonics import view_direction, write_basis
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.memory import aligned_floats, float_bits, gather, load, store
from tdgbench.splats.cpu.projection import (
    LOG2_E,
    along_axes,
    camera_point,
    clamped_ray,
    covariance_2d,
    deviations,
    jacobian_rows,
    long_axis,
    opacity_and_log2,
    rotation,
    screen_radius,
)
from tdgbench.splats.cpu.records import (
    A_, B_, C_, CHANNELS, LOG2_MIN_ALPHA, LOG2_OPACITY, MIN_ALPHA, OPACITY, RADIUS, U_, V_,
)  # fmt: skip
from tdgbench.splats.cpu.simd import LANES, divide, greater, maximum, select, splat, square_root
from tdgbench.splats.cpu.tiles import SLACK, TILE, list_tiles

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
FAR_AWAY = F(1e9)  # px: beyond it, whole numbers of pixels make no sense
# Registers of one group of Gaussians, from the vector half of the kernel to its scalar half.
VALID, Z, AXIS, WIDE, HIGH, SLOPE, CUT, DET = range(8, 16)  # 0 to 6: as in a record; channels from COLOR on
COLOR, GROUP = 16, 20


@kernel(inline=True)
def write_colors(group, colors, rows, k, stride, column, channels, degree, mx, my, mz, camera, basis):
    """Registers COLOR, COLOR + 1, … of the group: colours as given (degree −1) or from spherical harmonics."""
    if degree < 0:
        for c in range(channels):
            store(group, (COLOR + c) * LANES, gather(colors, rows, k, stride, column + c))
    else:
        x, y, z, _ = view_direction(mx, my, mz, camera)
        write_basis(x, y, z, degree, basis)
        for c in range(channels):
            total = splat(HALF)
            for b in range((degree + 1) * (degree + 1)):
                total = total + load(basis, b * LANES) * gather(colors, rows, k, stride, column + b * channels + c)
            store(group, (COLOR + c) * LANES, maximum(total, splat(ZERO)))


@kernel()
def project_and_list(
    first, count, candidates, means, scales, quats, opacities, colors, layout, raw, channels, degree, camera,
    depth_channel, first_pair, records, owners, boxes, pairs, depth_keys, order, seen, radii, means2d, tile_of_pair,
    pairs_per_tile, counts,
):  # fmt: skip
    """Project candidates [first, first + count); kept ones become records from `first` on.

    layout: stride and first column of the five arrays (means, scales, quats, opacities, colours) as flat memory.
    owners[r] is a record's Gaussian; pairs[r] = first and last + 1 of its pairs, counted from first_pair. seen, radii, means2d: what was projected,
    from `first` on. counts = [records, pairs, projected].
    """
    width, height = camera[22], camera[23]
    tiles_x = (int64(width) + TILE - 1) // TILE
    group, basis = aligned_floats(GROUP * LANES), aligned_floats(16 * LANES)
    one, zero = splat(ONE), splat(ZERO)
    n_records, n_seen = first, first
    n_pairs = 0
    for k in range(first, first + count, LANES):
        mx = gather(means, candidates, k, layout[0], layout[1])
        my = gather(means, candidates, k, layout[0], layout[1] + 1)
        mz = gather(means, candidates, k, layout[0], layout[1] + 2)
        s0, s1, s2 = deviations(scales, candidates, k, layout[2], layout[3], raw)
        qw = gather(quats, candidates, k, layout[4], layout[5])
        qx = gather(quats, candidates, k, layout[4], layout[5] + 1)
        qy = gather(quats, candidates, k, layout[4], layout[5] + 2)
        qz = gather(quats, candidates, k, layout[4], layout[5] + 3)
        opacity, log2_opacity = opacity_and_log2(opacities, candidates, k, layout[6], layout[7], raw)
        x, y, z = camera_point(mx, my, mz, camera)
        rz = divide(ONE, z)
        tx, ty = clamped_ray(x, y, rz, camera)
        r0, r1, r2, _, _ = rotation(qw, qx, qy, qz)
        ja, jb = jacobian_rows(tx, ty, rz, camera)
        p, q = along_axes(ja, r0, r1, r2), along_axes(jb, r0, r1, r2)
        p, q = (p[0] * s0, p[1] * s1, p[2] * s2), (q[0] * s0, q[1] * s1, q[2] * s2)
        a, b, c, det = covariance_2d(p, q, camera[21])
        valid = select(greater(z, splat(camera[19])), one, zero)
        valid = select(greater(splat(camera[20]), z), valid, zero)
        valid = select(greater(det, zero), valid, zero)
        valid = select(greater(splat(F(np.inf)), det), valid, zero)
        cut = log2_opacity - LOG2_MIN_ALPHA
        inverse = divide(ONE, det)
        wide = square_root(maximum(TWO / LOG2_E * cut * a, zero))
        store(group, U_ * LANES, x * rz * camera[12] + camera[14])
        store(group, V_ * LANES, y * rz * camera[13] + camera[15])
        store(group, A_ * LANES, -HALF * LOG2_E * c * inverse)
        store(group, B_ * LANES, LOG2_E * b * inverse)
        store(group, C_ * LANES, -HALF * LOG2_E * a * inverse)
        store(group, LOG2_OPACITY * LANES, log2_opacity)
        store(group, OPACITY * LANES, opacity)
        store(group, VALID * LANES, valid)
        store(group, Z * LANES, z)
        store(group, AXIS * LANES, long_axis(a, c, det))
        store(group, WIDE * LANES, wide)
        store(group, HIGH * LANES, square_root(maximum(TWO / LOG2_E * cut * c, zero)))
        store(group, SLOPE * LANES, divide(b * wide, a))
        store(group, CUT * LANES, cut)
        store(group, DET * LANES, det)
        write_colors(
            group, colors, candidates, k, layout[8], layout[9], channels, degree, mx, my, mz, camera, basis
        )  # fmt: skip
        for lane in range(min(LANES, first + count - k)):
            i = U(lane)
            if not (group[U(VALID * LANES) + i] > ZERO):
                continue
            u, v = group[U(U_ * LANES) + i], group[U(V_ * LANES) + i]
            at = U(n_seen)
            seen[at] = candidates[U(k) + i]
            radii[at] = np.int32(min(screen_radius(group[U(AXIS * LANES) + i], u, v, camera), FAR_AWAY))
            means2d[at, U(0)], means2d[at, U(1)] = u, v
            n_seen += 1
            if not (group[U(OPACITY * LANES) + i] >= MIN_ALPHA):
                continue
            hw, hh = group[U(WIDE * LANES) + i], group[U(HIGH * LANES) + i]
            left = max(u - hw - HALF - SLACK, ZERO)
            right = min(u + hw - HALF + SLACK, width - ONE)
            top = max(v - hh - HALF - SLACK, ZERO)
            bottom = min(v + hh - HALF + SLACK, height - ONE)
            if not (right >= left and bottom >= top):
                continue
            x0, x1 = int64(math.ceil(left)), int64(right)
            y0, y1 = int64(math.ceil(top)), int64(bottom)
            if x1 < x0 or y1 < y0:
                continue
            A, B, C = group[U(A_ * LANES) + i], group[U(B_ * LANES) + i], group[U(C_ * LANES) + i]
            before = n_pairs
            n_pairs = list_tiles(
                n_pairs, u, v, A, B, C, group[U(DET * LANES) + i], group[U(CUT * LANES) + i], hw, hh,
                group[U(SLOPE * LANES) + i], x0, x1, y0, y1, tiles_x, tile_of_pair, pairs_per_tile,
            )  # fmt: skip
            if n_pairs == before:
                continue
            r = U(n_records)
            for j in range(U(7)):
                records[r, j] = group[j * U(LANES) + i]
            for c in range(U(channels)):
                records[r, U(CHANNELS) + c] = group[(U(COLOR) + c) * U(LANES) + i]
            if depth_channel:
                records[r, U(CHANNELS + channels)] = group[U(Z * LANES) + i]
            records[r, U(RADIUS)] = F(radii[at])
            boxes[r, U(0)], boxes[r, U(1)], boxes[r, U(2)], boxes[r, U(3)] = x0, x1, y0, y1
            pairs[r, U(0)], pairs[r, U(1)] = first_pair + before, first_pair + n_pairs
            depth_keys[r] = float_bits(group[U(Z * LANES) + i])
            order[r] = n_records
            owners[r] = seen[at]
            n_records += 1
    counts[0] = n_records - first
    counts[1] = n_pairs
    counts[2] = n_seen - first
