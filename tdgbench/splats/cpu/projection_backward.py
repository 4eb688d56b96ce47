"""From a Gaussian's gradient slots back to its parameters: blend moments → 2-D Gaussian → EWA → mean, scale, rotation.

The derivatives are exact, those of the clamped ray included (3DGS's CUDA code treats the clamp as a constant).
"""

from __future__ import annotations

import functools
import math

import numpy as np

from tdgbench.splats.cpu.binning import CHANNELS, OPACITY
from tdgbench.splats.cpu.blend_backward import slot_size
from tdgbench.splats.cpu.harmonics import direction_gradient, view_direction, write_basis
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.projection import (
    along_axes,
    camera_point,
    clamped_ray,
    covariance_2d,
    jacobian_rows,
    rotation,
    scaled,
)

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
LN_2 = F(math.log(2))


@kernel(inline=True)
def conic_to_covariance(gx, gy, gz, x, y, z):
    """Gradient of the covariance (a, b, c) from that of its inverse (x, y, z): −M G M, b standing for both corners."""
    h = HALF * gy
    t00, t01 = gx * x + h * y, gx * y + h * z
    t10, t11 = h * x + gz * y, h * y + gz * z
    return -(x * t00 + y * t10), -TWO * (x * t01 + y * t11), -(y * t01 + z * t11)


@kernel(inline=True)
def quaternion_gradient(w, x, y, z, n, g0, g1, g2):
    """Gradient of the raw quaternion from that of the rotation's rows; w, x, y, z normalised, n = 1 / length."""
    dw = TWO * (x * (g2[1] - g1[2]) + y * (g0[2] - g2[0]) + z * (g1[0] - g0[1]))
    dx = TWO * (-TWO * x * (g1[1] + g2[2]) + y * (g0[1] + g1[0]) + z * (g0[2] + g2[0]) + w * (g2[1] - g1[2]))
    dy = TWO * (x * (g0[1] + g1[0]) - TWO * y * (g0[0] + g2[2]) + z * (g1[2] + g2[1]) + w * (g0[2] - g2[0]))
    dz = TWO * (x * (g0[2] + g2[0]) + y * (g1[2] + g2[1]) - TWO * z * (g0[0] + g1[1]) + w * (g1[0] - g0[1]))
    dot = dw * w + dx * x + dy * y + dz * z
    return (dw - dot * w) * n, (dx - dot * x) * n, (dy - dot * y) * n, (dz - dot * z) * n


@functools.cache
def make_projection_backward(channels: int, absgrad: bool):
    """The kernel for 1 to 4 blended channels (depth counted as one)."""
    size = slot_size(channels, absgrad)

    @kernel()
    def projection_backward(
        start, stop, means, scales, quats, colors, degree, camera, depth_channel, records, offsets, written, slots,
        grad_means, grad_scales, grad_quats, grad_opacities, grad_colors, grad_means2d, abs_means2d,
    ):  # fmt: skip
        """Gradients of Gaussians [start, stop). The outputs come in as zeros; untouched Gaussians stay so."""
        n_colors = U(colors.shape[2])
        total = np.empty(size, np.float32)
        basis = np.zeros(16, np.float32)
        pull = np.zeros(16, np.float32)
        for i_ in range(start, stop):
            i = U(i_)
            touched = False
            for j in range(U(size)):
                total[j] = ZERO
            for slot_ in range(offsets[i], offsets[i + U(1)]):
                slot = U(slot_)
                if written[slot] == 0:
                    continue
                touched = True
                for j in range(U(size)):
                    total[j] += slots[slot * U(size) + j]
            if not touched:
                continue
            grad_opacities[i] = total[0] / records[i, OPACITY]

            x, y, z = camera_point(i, means, camera)
            rz = ONE / z
            tx, ty = clamped_ray(x, y, rz, camera)
            r0, r1, r2, n = rotation(i, quats)
            ja, jb = jacobian_rows(tx, ty, rz, camera)
            p_unit = along_axes(ja, r0, r1, r2)
            q_unit = along_axes(jb, r0, r1, r2)
            p, q = scaled(p_unit, i, scales), scaled(q_unit, i, scales)
            a, b, c, det = covariance_2d(p, q, camera[21])
            cx, cy, cz = c / det, -b / det, a / det

            gu = cx * total[1] + cy * total[2]
            gv = cz * total[2] + cy * total[1]
            grad_means2d[i, 0] = gu
            grad_means2d[i, 1] = gv
            if absgrad:
                abs_means2d[i, 0] = LN_2 * total[size - 2]
                abs_means2d[i, 1] = LN_2 * total[size - 1]
            ga, gb, gc = conic_to_covariance(-HALF * total[3], -total[4], -HALF * total[5], cx, cy, cz)
            gp = (
                (TWO * ga * p[0] + gb * q[0]) * scales[i, 0],
                (TWO * ga * p[1] + gb * q[1]) * scales[i, 1],
                (TWO * ga * p[2] + gb * q[2]) * scales[i, 2],
            )
            gq = (
                (TWO * gc * q[0] + gb * p[0]) * scales[i, 0],
                (TWO * gc * q[1] + gb * p[1]) * scales[i, 1],
                (TWO * gc * q[2] + gb * p[2]) * scales[i, 2],
            )
            grad_scales[i, 0] = (TWO * ga * p[0] + gb * q[0]) * p_unit[0] + (TWO * gc * q[0] + gb * p[0]) * q_unit[0]
            grad_scales[i, 1] = (TWO * ga * p[1] + gb * q[1]) * p_unit[1] + (TWO * gc * q[1] + gb * p[1]) * q_unit[1]
            grad_scales[i, 2] = (TWO * ga * p[2] + gb * q[2]) * p_unit[2] + (TWO * gc * q[2] + gb * p[2]) * q_unit[2]
            g0 = (
                ja[0] * gp[0] + jb[0] * gq[0],
                ja[0] * gp[1] + jb[0] * gq[1],
                ja[0] * gp[2] + jb[0] * gq[2],
            )
            g1 = (
                ja[1] * gp[0] + jb[1] * gq[0],
                ja[1] * gp[1] + jb[1] * gq[1],
                ja[1] * gp[2] + jb[1] * gq[2],
            )
            g2 = (
                ja[2] * gp[0] + jb[2] * gq[0],
                ja[2] * gp[1] + jb[2] * gq[1],
                ja[2] * gp[2] + jb[2] * gq[2],
            )
            dw, dx, dy, dz = quaternion_gradient(
                quats[i, 0] * n, quats[i, 1] * n, quats[i, 2] * n, quats[i, 3] * n, n, g0, g1, g2
            )
            grad_quats[i, 0] = dw
            grad_quats[i, 1] = dx
            grad_quats[i, 2] = dy
            grad_quats[i, 3] = dz

            gja0 = r0[0] * gp[0] + r0[1] * gp[1] + r0[2] * gp[2]
            gja1 = r1[0] * gp[0] + r1[1] * gp[1] + r1[2] * gp[2]
            gja2 = r2[0] * gp[0] + r2[1] * gp[1] + r2[2] * gp[2]
            gjb0 = r0[0] * gq[0] + r0[1] * gq[1] + r0[2] * gq[2]
            gjb1 = r1[0] * gq[0] + r1[1] * gq[1] + r1[2] * gq[2]
            gjb2 = r2[0] * gq[0] + r2[1] * gq[1] + r2[2] * gq[2]
            fx, fy = camera[12], camera[13]
            sx, sy = fx * rz, fy * rz
            gsx = (gja0 * ja[0] + gja1 * ja[1] + gja2 * ja[2]) / sx
            gsy = (gjb0 * jb[0] + gjb1 * jb[1] + gjb2 * jb[2]) / sy
            gtx = -sx * (gja0 * camera[8] + gja1 * camera[9] + gja2 * camera[10])
            gty = -sy * (gjb0 * camera[8] + gjb1 * camera[9] + gjb2 * camera[10])
            g_rz = fx * gsx + fy * gsy + fx * x * gu + fy * y * gv
            gx, gy = sx * gu, sy * gv
            if tx == x * rz:
                gx += gtx * rz
                g_rz += gtx * x
            if ty == y * rz:
                gy += gty * rz
                g_rz += gty * y
            gz = -g_rz * rz * rz
            if depth_channel:
                gz += total[6 + channels - 1]

            dir_x, dir_y, dir_z = ZERO, ZERO, ZERO
            if degree < 0:
                for ch in range(n_colors):
                    grad_colors[i, U(0), ch] = total[U(6) + ch]
            else:
                vx, vy, vz, inverse = view_direction(means[i, 0], means[i, 1], means[i, 2], camera)
                write_basis(vx, vy, vz, degree, basis)
                n_bases = U((degree + 1) * (degree + 1))
                for k in range(n_bases):
                    pull[k] = ZERO
                for ch in range(n_colors):
                    if records[i, U(CHANNELS) + ch] > ZERO:
                        g = total[U(6) + ch]
                        for k in range(n_bases):
                            grad_colors[i, k, ch] = basis[k] * g
                            pull[k] += colors[i, k, ch] * g
                if degree > 0:
                    gdx, gdy, gdz = direction_gradient(vx, vy, vz, degree, pull)
                    dot = gdx * vx + gdy * vy + gdz * vz
                    dir_x = (gdx - dot * vx) * inverse
                    dir_y = (gdy - dot * vy) * inverse
                    dir_z = (gdz - dot * vz) * inverse
            grad_means[i, 0] = camera[0] * gx + camera[4] * gy + camera[8] * gz + dir_x
            grad_means[i, 1] = camera[1] * gx + camera[5] * gy + camera[9] * gz + dir_y
            grad_means[i, 2] = camera[2] * gx + camera[6] * gy + camera[10] * gz + dir_z

    return projection_backward
