"""Derivatives of EWA splatting, LANES Gaussians at a time: from the 2-D Gaussian to axes, rotation and mean.

Numbers are registers, vectors tuples of them; `footprint` is a `Footprint`.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.projection import dot
from tdgbench.splats.cpu.simd.memory import load
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, equal, select

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)


@kernel(inline=True)
def ellipse_gradient(totals, footprint, eps2d):
    """Gradients of p_unit and q_unit (vectors), of the deviations, and of the image mean (u, v).

    totals (slot · LANES,) float32: sums over each splat's slots, a register each.
    """
    t1, t2 = load(totals, LANES), load(totals, 2 * LANES)
    t3, t4, t5 = load(totals, 3 * LANES), load(totals, 4 * LANES), load(totals, 5 * LANES)
    a, b, c = footprint.covariance
    p, q, p_unit, q_unit = footprint.p, footprint.q, footprint.p_unit, footprint.q_unit
    s0, s1, s2 = footprint.scales
    inverse = divide(ONE, footprint.det)
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
    """Gradients of w and (x, y, z) of the raw quaternion from the rows of the rotation's.

    quat is normalised, per_length = 1 / length.
    """
    w, x, y, z = quat
    g0, g1, g2 = rows
    dw = TWO * (x * (g2[1] - g1[2]) + y * (g0[2] - g2[0]) + z * (g1[0] - g0[1]))
    dx = TWO * (-TWO * x * (g1[1] + g2[2]) + y * (g0[1] + g1[0]) + z * (g0[2] + g2[0]) + w * (g2[1] - g1[2]))
    dy = TWO * (x * (g0[1] + g1[0]) - TWO * y * (g0[0] + g2[2]) + z * (g1[2] + g2[1]) + w * (g0[2] - g2[0]))
    dz = TWO * (x * (g0[2] + g2[0]) + y * (g1[2] + g2[1]) - TWO * z * (g0[0] + g1[1]) + w * (g1[0] - g0[1]))
    along = dw * w + dx * x + dy * y + dz * z
    by_vector = ((dx - along * x) * per_length, (dy - along * y) * per_length, (dz - along * z) * per_length)
    return (dw - along * w) * per_length, by_vector


@kernel(inline=True)
def point_gradient(footprint, gp, gq, g_mean2d, camera):
    """Gradient of the mean in camera coordinates, without that of the depth channel."""
    x, y, _ = footprint.point
    rz, ja, jb = footprint.rz, footprint.ja, footprint.jb
    tx, ty = footprint.ray
    gu, gv = g_mean2d
    r0, r1, r2 = footprint.axes
    gja = (dot(r0, gp), dot(r1, gp), dot(r2, gp))
    gjb = (dot(r0, gq), dot(r1, gq), dot(r2, gq))
    z_axis, zero = camera.z_axis, broadcast(ZERO)
    sx, sy = camera.fx * rz, camera.fy * rz
    gsx = divide(dot(gja, ja), sx)
    gsy = divide(dot(gjb, jb), sy)
    gtx, gty = -sx * dot(gja, z_axis), -sy * dot(gjb, z_axis)
    gtx, gty = select(equal(tx, x * rz), gtx, zero), select(equal(ty, y * rz), gty, zero)  # zero where clamped
    gx, gy = sx * gu + gtx * rz, sy * gv + gty * rz
    g_rz = camera.fx * gsx + camera.fy * gsy + camera.fx * x * gu + camera.fy * y * gv + gtx * x + gty * y
    return gx, gy, -g_rz * rz * rz
