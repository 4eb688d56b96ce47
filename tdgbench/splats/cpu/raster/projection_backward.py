"""From a Gaussian's gradient slots back to its parameters: blend moments → 2-D Gaussian → EWA → mean, scale, rotation.

The derivatives are exact, those of the clamped ray included (3DGS's CUDA code treats the clamp as a constant). Only
Gaussians that some pixel depends on get a row of gradients; LANES of them are worked on at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blend_backward import MOMENTS
from tdgbench.splats.cpu.raster.harmonics import direction_gradient, view_direction, write_basis
from tdgbench.splats.cpu.raster.projection import column, footprint
from tdgbench.splats.cpu.raster.splat import CHANNELS, FLOATS, OPACITY, RADIUS
from tdgbench.splats.cpu.simd.memory import (
    aligned_floats,
    gather,
    load,
    prefetch,
    prefetch_columns,
    put_column,
    store,
)
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, equal, greater, select

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
PREFETCH_DISTANCE = 16  # splats
MAX_SLOT = MOMENTS + 4  # floats


class Scratch(NamedTuple):
    """A thread's buffers for one group of LANES splats; float32 ones hold registers."""

    totals: np.ndarray  # (MAX_SLOT · LANES,) float32: sums over each splat's slots
    basis: np.ndarray  # (16 · LANES,) float32: spherical harmonics
    pull: np.ndarray  # (16 · LANES,) float32: gradients of the basis functions
    splat_ids: np.ndarray  # (LANES,) int32


@kernel()
def projection_backward(first, count, parameters, channels, camera, splats, slots, rows):
    """Gradients of splats [first, first + count), for those that have any; returns how many rows that is.

    Arguments are of the types that have their names; rows: GradientArrays, written from `first` on.
    """
    scratch = Scratch(
        aligned_floats(MAX_SLOT * LANES),
        aligned_floats(16 * LANES),
        aligned_floats(16 * LANES),
        np.zeros(LANES, np.int32),
    )
    total = np.empty(MAX_SLOT, np.float32)
    slot_floats = MOMENTS + channels.colors + channels.depth
    pairs, values, written = splats.pairs, slots.values, slots.written
    done, filled = first, 0
    r = first
    while r < first + count or filled > 0:
        if r < first + count:
            prefetch_parameters(
                splats.gaussian_ids[U(min(r + PREFETCH_DISTANCE, first + count - 1))], parameters, channels
            )
            for j in range(U(slot_floats)):
                total[j] = ZERO
            for slot in range(pairs[U(r), U(0)], pairs[U(r), U(1)]):
                if written[U(slot)]:
                    for j in range(U(slot_floats)):
                        total[j] += values[U(slot) * U(slot_floats) + j]
            pulled = False
            for j in range(U(slot_floats)):
                pulled = pulled or total[j] != ZERO
            if pulled:
                for j in range(U(slot_floats)):
                    scratch.totals[j * U(LANES) + U(filled)] = total[j]
                scratch.splat_ids[filled] = r
                rows.gaussian_ids[U(done + filled)] = splats.gaussian_ids[U(r)]
                filled += 1
            r += 1
            if filled < LANES and r < first + count:
                continue
        if filled == 0:
            break
        for lane in range(filled, LANES):  # an unfinished group repeats its first splat; those rows are unused
            scratch.splat_ids[lane] = scratch.splat_ids[0]
            rows.gaussian_ids[U(done + lane)] = rows.gaussian_ids[U(done)]
        write_rows(done, parameters, channels, camera, splats.values, scratch, rows)
        done += filled
        filled = 0
    return done - first


@kernel(inline=True)
def prefetch_parameters(gaussian_id, parameters, channels):
    """Prefetch the mean and the colours of a Gaussian."""
    means, colors, i = parameters.means, parameters.colors, np.int64(gaussian_id)
    n_bases = (channels.degree + 1) * (channels.degree + 1) if channels.degree >= 0 else 1
    prefetch(means.values, U(i * means.stride + means.first))
    prefetch_columns(colors.values, i, colors.stride, colors.first, n_bases * channels.colors)


@kernel(inline=True)
def write_rows(done, parameters, channels, camera, splats, scratch, rows):
    """Gradient rows done, done + 1, … of the group in `scratch`; splats (n, 16) float32."""
    totals, stride = scratch.totals, rows.values.shape[1]
    seen = footprint(parameters, rows.gaussian_ids, done, camera)
    scales = seen.scales
    opacity = gather(splats, scratch.splat_ids, 0, FLOATS, OPACITY)
    t0 = load(totals, 0)
    if parameters.raw:
        put_column(rows.values, done, stride, OPACITY_AT, t0 * (ONE - opacity))
    else:
        put_column(rows.values, done, stride, OPACITY_AT, divide(t0, opacity))

    gp, gq, g_scales, g_mean2d = ellipse_gradient(totals, seen, camera.eps2d)
    put_column(rows.image, done, 3, 0, g_mean2d[0])
    put_column(rows.image, done, 3, 1, g_mean2d[1])
    put_column(rows.image, done, 3, 2, gather(splats, scratch.splat_ids, 0, FLOATS, RADIUS))
    if parameters.raw:
        g_scales = (g_scales[0] * scales[0], g_scales[1] * scales[1], g_scales[2] * scales[2])
    put_three(rows.values, done, SCALES_AT, g_scales)
    dw, dx, dy, dz = quaternion_gradient(seen.quat, seen.per_length, outer(seen.ja, seen.jb, gp, gq))
    put_column(rows.values, done, stride, QUATS_AT, dw)
    put_three(rows.values, done, QUATS_AT + 1, (dx, dy, dz))

    gx, gy, gz = point_gradient(seen, gp, gq, g_mean2d, camera)
    if channels.depth:
        gz = gz + load(totals, (MOMENTS + channels.colors) * LANES)
    g_mean = (
        gx * camera.x_axis[0] + gy * camera.y_axis[0] + gz * camera.z_axis[0],
        gx * camera.x_axis[1] + gy * camera.y_axis[1] + gz * camera.z_axis[1],
        gx * camera.x_axis[2] + gy * camera.y_axis[2] + gz * camera.z_axis[2],
    )
    if channels.degree < 0:
        used = COLORS_AT + channels.colors
        for c in range(channels.colors):
            put_column(rows.values, done, stride, COLORS_AT + c, load(totals, (MOMENTS + c) * LANES))
    else:
        used = COLORS_AT + (channels.degree + 1) * (channels.degree + 1) * channels.colors
        g_mean = harmonics_gradient(g_mean, seen.mean, done, parameters.colors, channels, camera, splats, scratch, rows)
    put_three(rows.values, done, MEANS_AT, g_mean)
    for unused in range(used, stride):
        put_column(rows.values, done, stride, unused, broadcast(ZERO))


@kernel(inline=True)
def put_three(values, row, first_column, vector):
    """Put a vector into columns first_column, + 1, + 2 of rows `row`, row + 1, … of values (n, columns) float32."""
    stride = values.shape[1]
    put_column(values, row, stride, first_column, vector[0])
    put_column(values, row, stride, first_column + 1, vector[1])
    put_column(values, row, stride, first_column + 2, vector[2])


@kernel(inline=True)
def ellipse_gradient(totals, seen, eps2d):
    """Gradients of p_unit and q_unit (vectors), of the deviations, and of the image mean (u, v).

    totals: see Scratch; seen: Footprint.
    """
    t1, t2 = load(totals, LANES), load(totals, 2 * LANES)
    t3, t4, t5 = load(totals, 3 * LANES), load(totals, 4 * LANES), load(totals, 5 * LANES)
    a, b, c = seen.covariance
    p, q, p_unit, q_unit = seen.p, seen.q, seen.p_unit, seen.q_unit
    s0, s1, s2 = seen.scales
    inverse = divide(ONE, seen.det)
    conic = (c * inverse, b * inverse, a * inverse)
    gu, gv = conic[0] * t1 - conic[1] * t2, conic[2] * t2 - conic[1] * t1
    moments = (-HALF * t3, -HALF * t4, -HALF * t5)
    y0 = whitened((p_unit[0], q_unit[0]), p, q, 1, 2, eps2d, inverse)
    y1 = whitened((p_unit[1], q_unit[1]), p, q, 2, 0, eps2d, inverse)
    y2 = whitened((p_unit[2], q_unit[2]), p, q, 0, 1, eps2d, inverse)
    h0, k0, g_s0 = axis_gradient(y0, s0, moments, conic)
    h1, k1, g_s1 = axis_gradient(y1, s1, moments, conic)
    h2, k2, g_s2 = axis_gradient(y2, s2, moments, conic)
    return (h0 * s0, h1 * s1, h2 * s2), (k0 * s0, k1 * s1, k2 * s2), (g_s0, g_s1, g_s2), (gu, gv)


@kernel(inline=True)
def whitened(w, p, q, one, other, eps2d, inverse):
    """M w of an axis w (u, v), for the inverse M of the image covariance Σ_l a_l a_lᵀ + eps I.

    a_l = (p_l, q_l) are the scaled axes; `one` and `other` number the two that do not belong to w; inverse = 1 / det.
    adj(a aᵀ) w = (a⊥ · w) a⊥ with a⊥ = (q, −p): an axis adds nothing to its product with itself. Written so, a
    needle's long axis loses no digits, where the entries of M would cancel.
    """
    w_u, w_v = w
    c1, c2 = q[one] * w_u - p[one] * w_v, q[other] * w_u - p[other] * w_v
    u = c1 * q[one] + c2 * q[other] + eps2d * w_u
    v = eps2d * w_v - (c1 * p[one] + c2 * p[other])
    return u * inverse, v * inverse


@kernel(inline=True)
def axis_gradient(y, s, g, conic):
    """Gradient of a scaled axis a = s w (u, v) and of its length s, given y = M w and the gradient g (xx, xy, yy) of M.

    conic: (xx, −xy, yy) of M.  dΣ = a daᵀ + da aᵀ and dM = −M dΣ M:  dL/da = −2 M G (M a),
    dL/ds = w · dL/da = −2 s yᵀ G y.
    """
    z_u, z_v = g[0] * y[0] + g[1] * y[1], g[1] * y[0] + g[2] * y[1]
    by_u = -TWO * s * (conic[0] * z_u - conic[1] * z_v)
    by_v = TWO * s * (conic[1] * z_u - conic[2] * z_v)
    return by_u, by_v, -TWO * s * (y[0] * z_u + y[1] * z_v)


@kernel(inline=True)
def outer(ja, jb, gp, gq):
    """Rows of the rotation's gradient: ja gpᵀ + jb gqᵀ."""
    return (
        (ja[0] * gp[0] + jb[0] * gq[0], ja[0] * gp[1] + jb[0] * gq[1], ja[0] * gp[2] + jb[0] * gq[2]),
        (ja[1] * gp[0] + jb[1] * gq[0], ja[1] * gp[1] + jb[1] * gq[1], ja[1] * gp[2] + jb[1] * gq[2]),
        (ja[2] * gp[0] + jb[2] * gq[0], ja[2] * gp[1] + jb[2] * gq[1], ja[2] * gp[2] + jb[2] * gq[2]),
    )


@kernel(inline=True)
def quaternion_gradient(quat, per_length, rows):
    """Gradient of the raw quaternion from the rows of the rotation's; quat is normalised, per_length = 1 / length."""
    w, x, y, z = quat
    g0, g1, g2 = rows
    dw = TWO * (x * (g2[1] - g1[2]) + y * (g0[2] - g2[0]) + z * (g1[0] - g0[1]))
    dx = TWO * (-TWO * x * (g1[1] + g2[2]) + y * (g0[1] + g1[0]) + z * (g0[2] + g2[0]) + w * (g2[1] - g1[2]))
    dy = TWO * (x * (g0[1] + g1[0]) - TWO * y * (g0[0] + g2[2]) + z * (g1[2] + g2[1]) + w * (g0[2] - g2[0]))
    dz = TWO * (x * (g0[2] + g2[0]) + y * (g1[2] + g2[1]) - TWO * z * (g0[0] + g1[1]) + w * (g1[0] - g0[1]))
    dot = dw * w + dx * x + dy * y + dz * z
    return (
        (dw - dot * w) * per_length,
        (dx - dot * x) * per_length,
        (dy - dot * y) * per_length,
        (dz - dot * z) * per_length,
    )


@kernel(inline=True)
def point_gradient(seen, gp, gq, g_mean2d, camera):
    """Gradient of the mean in camera coordinates, without that of the depth channel; seen: Footprint."""
    x, y, _ = seen.point
    rz, ja, jb = seen.rz, seen.ja, seen.jb
    tx, ty = seen.ray
    gu, gv = g_mean2d
    r0, r1, r2 = seen.axes
    gja0 = r0[0] * gp[0] + r0[1] * gp[1] + r0[2] * gp[2]
    gja1 = r1[0] * gp[0] + r1[1] * gp[1] + r1[2] * gp[2]
    gja2 = r2[0] * gp[0] + r2[1] * gp[1] + r2[2] * gp[2]
    gjb0 = r0[0] * gq[0] + r0[1] * gq[1] + r0[2] * gq[2]
    gjb1 = r1[0] * gq[0] + r1[1] * gq[1] + r1[2] * gq[2]
    gjb2 = r2[0] * gq[0] + r2[1] * gq[1] + r2[2] * gq[2]
    z_axis, zero = camera.z_axis, broadcast(ZERO)
    sx, sy = camera.fx * rz, camera.fy * rz
    gsx = divide(gja0 * ja[0] + gja1 * ja[1] + gja2 * ja[2], sx)
    gsy = divide(gjb0 * jb[0] + gjb1 * jb[1] + gjb2 * jb[2], sy)
    gtx = -sx * (gja0 * z_axis[0] + gja1 * z_axis[1] + gja2 * z_axis[2])
    gty = -sy * (gjb0 * z_axis[0] + gjb1 * z_axis[1] + gjb2 * z_axis[2])
    gtx, gty = select(equal(tx, x * rz), gtx, zero), select(equal(ty, y * rz), gty, zero)  # zero where clamped
    gx, gy = sx * gu + gtx * rz, sy * gv + gty * rz
    g_rz = camera.fx * gsx + camera.fy * gsy + camera.fx * x * gu + camera.fy * y * gv + gtx * x + gty * y
    return gx, gy, -g_rz * rz * rz


@kernel(inline=True)
def harmonics_gradient(g_mean, mean, done, colors, channels, camera, splats, scratch, rows):
    """Write the gradients of the coefficients; returns that of the mean, with the part of the viewing direction.

    colors: Columns; splats (n, 16) float32.
    """
    stride, n_bases = rows.values.shape[1], (channels.degree + 1) * (channels.degree + 1)
    vx, vy, vz, per_distance = view_direction(mean, camera)
    write_basis(vx, vy, vz, channels.degree, scratch.basis)
    for k in range(n_bases):
        store(scratch.pull, k * LANES, broadcast(ZERO))
    for c in range(channels.colors):
        lit = greater(gather(splats, scratch.splat_ids, 0, FLOATS, CHANNELS + c), broadcast(ZERO))  # else held at zero
        g = select(lit, load(scratch.totals, (MOMENTS + c) * LANES), broadcast(ZERO))
        for k in range(n_bases):
            at = k * channels.colors + c
            put_column(rows.values, done, stride, COLORS_AT + at, load(scratch.basis, k * LANES) * g)
            coefficient = column(colors, rows.gaussian_ids, done, at)
            store(scratch.pull, k * LANES, load(scratch.pull, k * LANES) + coefficient * g)
    gx, gy, gz = g_mean
    if channels.degree > 0:
        gdx, gdy, gdz = direction_gradient(vx, vy, vz, channels.degree, scratch.pull)
        dot = gdx * vx + gdy * vy + gdz * vz
        gx = gx + (gdx - dot * vx) * per_distance
        gy = gy + (gdy - dot * vy) * per_distance
        gz = gz + (gdz - dot * vz) * per_distance
    return gx, gy, gz
