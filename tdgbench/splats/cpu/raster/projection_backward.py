"""From a Gaussian's gradient slots back to its parameters: blend moments → 2-D Gaussian → EWA → mean, scale, rotation.

The derivatives are exact, those of the clamped ray included (3DGS's CUDA code treats the clamp as a constant). Only
Gaussians that some pixel pulls at get a row of gradients; LANES of them are worked on at a time.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.harmonics import direction_gradient, view_direction, write_basis
from tdgbench.splats.cpu.raster.projection import (
    along_axes,
    camera_point,
    clamped_ray,
    covariance_2d,
    deviations,
    jacobian_rows,
    rotation,
)
from tdgbench.splats.cpu.raster.records import CHANNELS, OPACITY, RADIUS, RECORD
from tdgbench.splats.cpu.simd.memory import (
    aligned_floats,
    gather,
    gather_3,
    load,
    prefetch,
    prefetch_columns,
    put_column,
    store,
)
from tdgbench.splats.cpu.simd.registers import LANES, divide, equal, greater, select, splat

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
LOOK_AHEAD = 16
MAX_SLOT = 10  # floats: six moments, four channels


@kernel(inline=True)
def whitened(w_u, w_v, p, q, one, other, eps2d, inverse):
    """M w of an axis w, for the inverse M of the image covariance Σ_l a_l a_lᵀ + eps I, a_l = (p_l, q_l) being the
    scaled axes, of which `one` and `other` are not w's own; inverse = 1 / det.

    adj(a aᵀ) w = (a⊥ · w) a⊥ with a⊥ = (q, −p): an axis adds nothing to its own product. Written so, a needle's long
    axis loses no digits, where the entries of M would cancel.
    """
    c1, c2 = q[one] * w_u - p[one] * w_v, q[other] * w_u - p[other] * w_v
    u = c1 * q[one] + c2 * q[other] + eps2d * w_u
    v = eps2d * w_v - (c1 * p[one] + c2 * p[other])
    return u * inverse, v * inverse


@kernel(inline=True)
def axis_gradient(y, s, g, cx, cy, cz):
    """Gradient of a scaled axis a = s w and of its length s, given y = M w and the gradient g (xx, xy, yy) of M.

    dΣ = a daᵀ + da aᵀ and dM = −M dΣ M:  dL/da = −2 M G (M a),  dL/ds = w · dL/da = −2 s yᵀ G y.
    """
    z_u, z_v = g[0] * y[0] + g[1] * y[1], g[1] * y[0] + g[2] * y[1]
    of_length = -TWO * s * (y[0] * z_u + y[1] * z_v)
    scale = -TWO * s
    return scale * (cx * z_u + cy * z_v), scale * (cy * z_u + cz * z_v), of_length


@kernel(inline=True)
def quaternion_gradient(w, x, y, z, n, g0, g1, g2):
    """Gradient of the raw quaternion from that of the rotation's rows; w, x, y, z normalised, n = 1 / length."""
    dw = TWO * (x * (g2[1] - g1[2]) + y * (g0[2] - g2[0]) + z * (g1[0] - g0[1]))
    dx = TWO * (-TWO * x * (g1[1] + g2[2]) + y * (g0[1] + g1[0]) + z * (g0[2] + g2[0]) + w * (g2[1] - g1[2]))
    dy = TWO * (x * (g0[1] + g1[0]) - TWO * y * (g0[0] + g2[2]) + z * (g1[2] + g2[1]) + w * (g0[2] - g2[0]))
    dz = TWO * (x * (g0[2] + g2[0]) + y * (g1[2] + g2[1]) - TWO * z * (g0[0] + g1[1]) + w * (g1[0] - g0[1]))
    dot = dw * w + dx * x + dy * y + dz * z
    return (dw - dot * w) * n, (dx - dot * x) * n, (dy - dot * y) * n, (dz - dot * z) * n


@kernel()
def projection_backward(
    first, count, owners, means, scales, quats, opacities, colors, layout, raw, channels, degree, camera,
    depth_channel, records, pairs, slots, written, slot_size, stride, touched, gradients, image_gradients,
):  # fmt: skip
    """Gradients of records [first, first + count), for those that have any; returns how many rows that is.

    Rows are written from `first` on: touched (the Gaussian), gradients (means, scales, quats, opacity, colours, zeros
    up to `stride`), image_gradients (d/du, d/dv, radius).
    """
    total, basis = aligned_floats(MAX_SLOT * LANES), aligned_floats(16 * LANES)
    pull = aligned_floats(16 * LANES)
    own = np.empty(MAX_SLOT, np.float32)
    place = np.zeros(LANES, np.int32)  # the records of the group
    n_bases = (degree + 1) * (degree + 1) if degree >= 0 else 1
    used = COLORS_AT + n_bases * channels
    zero = splat(ZERO)
    done, filled = first, 0
    r = first
    while r < first + count or filled > 0:
        if r < first + count:
            ahead = np.int64(owners[U(min(r + LOOK_AHEAD, first + count - 1))])
            prefetch(means, U(ahead * layout[0] + layout[1]))
            prefetch_columns(colors, ahead, layout[8], layout[9], n_bases * channels)
            for j in range(U(slot_size)):
                own[j] = ZERO
            for slot in range(pairs[U(r), U(0)], pairs[U(r), U(1)]):
                if written[U(slot)]:
                    for j in range(U(slot_size)):
                        own[j] += slots[U(slot) * U(slot_size) + j]
            pulled = False
            for j in range(U(slot_size)):
                pulled = pulled or own[j] != ZERO
            if pulled:
                for j in range(U(slot_size)):
                    total[j * U(LANES) + U(filled)] = own[j]
                place[filled] = r
                touched[U(done + filled)] = owners[U(r)]
                filled += 1
            r += 1
            if filled < LANES and r < first + count:
                continue
        if filled == 0:
            break
        for lane in range(filled, LANES):  # an unfinished group repeats its first record; nobody reads those rows
            place[lane] = place[0]
            touched[U(done + lane)] = touched[U(done)]

        mean = gather_3(means, touched, done, layout[0], layout[1])
        s0, s1, s2 = deviations(scales, touched, done, layout[2], layout[3], raw)
        r0, r1, r2, unit, n = rotation(quats, touched, done, layout[4], layout[5])
        opacity = gather(records, place, 0, RECORD, OPACITY)
        t0 = load(total, 0)
        t1, t2 = load(total, LANES), load(total, 2 * LANES)
        t3, t4, t5 = load(total, 3 * LANES), load(total, 4 * LANES), load(total, 5 * LANES)
        if raw:
            put_column(gradients, done, stride, OPACITY_AT, t0 * (ONE - opacity))
        else:
            put_column(gradients, done, stride, OPACITY_AT, divide(t0, opacity))

        x, y, z = camera_point(mean, camera)
        rz = divide(ONE, z)
        tx, ty = clamped_ray(x, y, rz, camera)
        ja, jb = jacobian_rows(tx, ty, rz, camera)
        p_unit, q_unit = along_axes(ja, r0, r1, r2), along_axes(jb, r0, r1, r2)
        p = (p_unit[0] * s0, p_unit[1] * s1, p_unit[2] * s2)
        q = (q_unit[0] * s0, q_unit[1] * s1, q_unit[2] * s2)
        a, b, c, det = covariance_2d(p, q, camera[21])
        inverse = divide(ONE, det)
        cx, cy, cz = c * inverse, ZERO - b * inverse, a * inverse

        gu = cx * t1 + cy * t2
        gv = cz * t2 + cy * t1
        put_column(image_gradients, done, 3, 0, gu)
        put_column(image_gradients, done, 3, 1, gv)
        put_column(image_gradients, done, 3, 2, gather(records, place, 0, RECORD, RADIUS))
        moments = (-HALF * t3, -HALF * t4, -HALF * t5)
        y0 = whitened(p_unit[0], q_unit[0], p, q, 1, 2, camera[21], inverse)
        y1 = whitened(p_unit[1], q_unit[1], p, q, 2, 0, camera[21], inverse)
        y2 = whitened(p_unit[2], q_unit[2], p, q, 0, 1, camera[21], inverse)
        h0, k0, g_s0 = axis_gradient(y0, s0, moments, cx, cy, cz)
        h1, k1, g_s1 = axis_gradient(y1, s1, moments, cx, cy, cz)
        h2, k2, g_s2 = axis_gradient(y2, s2, moments, cx, cy, cz)
        if raw:
            g_s0, g_s1, g_s2 = g_s0 * s0, g_s1 * s1, g_s2 * s2
        put_column(gradients, done, stride, SCALES_AT, g_s0)
        put_column(gradients, done, stride, SCALES_AT + 1, g_s1)
        put_column(gradients, done, stride, SCALES_AT + 2, g_s2)
        gp = (h0 * s0, h1 * s1, h2 * s2)
        gq = (k0 * s0, k1 * s1, k2 * s2)
        g0 = (ja[0] * gp[0] + jb[0] * gq[0], ja[0] * gp[1] + jb[0] * gq[1], ja[0] * gp[2] + jb[0] * gq[2])
        g1 = (ja[1] * gp[0] + jb[1] * gq[0], ja[1] * gp[1] + jb[1] * gq[1], ja[1] * gp[2] + jb[1] * gq[2])
        g2 = (ja[2] * gp[0] + jb[2] * gq[0], ja[2] * gp[1] + jb[2] * gq[1], ja[2] * gp[2] + jb[2] * gq[2])
        dw, dx, dy, dz = quaternion_gradient(unit[0], unit[1], unit[2], unit[3], n, g0, g1, g2)
        put_column(gradients, done, stride, QUATS_AT, dw)
        put_column(gradients, done, stride, QUATS_AT + 1, dx)
        put_column(gradients, done, stride, QUATS_AT + 2, dy)
        put_column(gradients, done, stride, QUATS_AT + 3, dz)

        gja0 = r0[0] * gp[0] + r0[1] * gp[1] + r0[2] * gp[2]
        gja1 = r1[0] * gp[0] + r1[1] * gp[1] + r1[2] * gp[2]
        gja2 = r2[0] * gp[0] + r2[1] * gp[1] + r2[2] * gp[2]
        gjb0 = r0[0] * gq[0] + r0[1] * gq[1] + r0[2] * gq[2]
        gjb1 = r1[0] * gq[0] + r1[1] * gq[1] + r1[2] * gq[2]
        gjb2 = r2[0] * gq[0] + r2[1] * gq[1] + r2[2] * gq[2]
        fx, fy = camera[12], camera[13]
        sx, sy = fx * rz, fy * rz
        gsx = divide(gja0 * ja[0] + gja1 * ja[1] + gja2 * ja[2], sx)
        gsy = divide(gjb0 * jb[0] + gjb1 * jb[1] + gjb2 * jb[2], sy)
        gtx = -sx * (gja0 * camera[8] + gja1 * camera[9] + gja2 * camera[10])
        gty = -sy * (gjb0 * camera[8] + gjb1 * camera[9] + gjb2 * camera[10])
        gtx, gty = select(equal(tx, x * rz), gtx, zero), select(equal(ty, y * rz), gty, zero)  # zero where clamped
        gx, gy = sx * gu + gtx * rz, sy * gv + gty * rz
        g_rz = fx * gsx + fy * gsy + fx * x * gu + fy * y * gv + gtx * x + gty * y
        gz = -g_rz * rz * rz
        if depth_channel:
            gz = gz + load(total, (6 + channels) * LANES)
        gx, gy, gz = (
            gx * camera[0] + gy * camera[4] + gz * camera[8],
            gx * camera[1] + gy * camera[5] + gz * camera[9],
            gx * camera[2] + gy * camera[6] + gz * camera[10],
        )

        if degree < 0:
            for ch in range(channels):
                put_column(gradients, done, stride, COLORS_AT + ch, load(total, (6 + ch) * LANES))
        else:
            vx, vy, vz, per_distance = view_direction(mean, camera)
            write_basis(vx, vy, vz, degree, basis)
            for k in range(n_bases):
                store(pull, k * LANES, zero)
            for ch in range(channels):
                lit = greater(gather(records, place, 0, RECORD, CHANNELS + ch), zero)  # else held at zero
                g = select(lit, load(total, (6 + ch) * LANES), zero)
                for k in range(n_bases):
                    put_column(gradients, done, stride, COLORS_AT + k * channels + ch, load(basis, k * LANES) * g)
                    coefficient = gather(colors, touched, done, layout[8], layout[9] + k * channels + ch)
                    store(pull, k * LANES, load(pull, k * LANES) + coefficient * g)
            if degree > 0:
                gdx, gdy, gdz = direction_gradient(vx, vy, vz, degree, pull)
                dot = gdx * vx + gdy * vy + gdz * vz
                gx = gx + (gdx - dot * vx) * per_distance
                gy = gy + (gdy - dot * vy) * per_distance
                gz = gz + (gdz - dot * vz) * per_distance
        put_column(gradients, done, stride, MEANS_AT, gx)
        put_column(gradients, done, stride, MEANS_AT + 1, gy)
        put_column(gradients, done, stride, MEANS_AT + 2, gz)
        for column in range(used, stride):
            put_column(gradients, done, stride, column, zero)
        done += filled
        filled = 0
    return done - first
