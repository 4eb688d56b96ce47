"""Projection of one 3-D Gaussian to a 2-D one (EWA splatting; Zwicker et al. 2001, as used by 3DGS).

The camera is one float32 array: [0:12] the rows of world-to-camera [R | t], [12:16] fx fy cx cy, [16:19] camera
centre, [19] near, [20] far, [21] eps2d, [22] width, [23] height. Pixel centres lie at whole numbers + 1/2.
"""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.cpu.jit import kernel

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
CAMERA_SIZE = 24


@kernel(inline=True)
def camera_point(i, means, camera):
    """The mean in camera coordinates."""
    mx, my, mz = means[i, 0], means[i, 1], means[i, 2]
    x = camera[0] * mx + camera[1] * my + camera[2] * mz + camera[3]
    y = camera[4] * mx + camera[5] * my + camera[6] * mz + camera[7]
    z = camera[8] * mx + camera[9] * my + camera[10] * mz + camera[11]
    return x, y, z


@kernel(inline=True)
def rotation(i, quats):
    """Rows of the rotation matrix of the normalised quaternion (wxyz), and 1 / |quaternion|."""
    w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
    n = ONE / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * n, x * n, y * n, z * n
    return (
        (ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y)),
        (TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x)),
        (TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y)),
        n,
    )


@kernel(inline=True)
def clamped_ray(x, y, rz, camera):
    """tan of the viewing ray, clamped to 1.3 × the field of view where the linearisation would explode (3DGS)."""
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    margin_x, margin_y = F(0.15) * camera[22] / fx, F(0.15) * camera[23] / fy
    tx = min((camera[22] - cx) / fx + margin_x, max(-cx / fx - margin_x, x * rz))
    ty = min((camera[23] - cy) / fy + margin_y, max(-cy / fy - margin_y, y * rz))
    return tx, ty


@kernel(inline=True)
def jacobian_rows(tx, ty, rz, camera):
    """Rows of J·R: how u and v move with the mean in world coordinates."""
    sx, sy = camera[12] * rz, camera[13] * rz
    ja = (
        sx * (camera[0] - tx * camera[8]),
        sx * (camera[1] - tx * camera[9]),
        sx * (camera[2] - tx * camera[10]),
    )
    jb = (
        sy * (camera[4] - ty * camera[8]),
        sy * (camera[5] - ty * camera[9]),
        sy * (camera[6] - ty * camera[10]),
    )
    return ja, jb


@kernel(inline=True)
def along_axes(j, r0, r1, r2):
    """j · (columns of the rotation): a Jacobian row seen along the Gaussian's axes."""
    return (
        j[0] * r0[0] + j[1] * r1[0] + j[2] * r2[0],
        j[0] * r0[1] + j[1] * r1[1] + j[2] * r2[1],
        j[0] * r0[2] + j[1] * r1[2] + j[2] * r2[2],
    )


@kernel(inline=True)
def scaled(v, i, scales):
    """v times the Gaussian's standard deviations, axis by axis."""
    return v[0] * scales[i, 0], v[1] * scales[i, 1], v[2] * scales[i, 2]


@kernel(inline=True)
def covariance_2d(p, q, eps2d):
    """Image covariance [[a, b], [b, c]] of the scaled axes p, q, and its determinant.

    det = |p × q|² + eps (|p|² + |q|²) + eps²: sums of squares only, where a·c − b² would cancel for needles.
    """
    pp = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    qq = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
    b = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    k0 = p[1] * q[2] - p[2] * q[1]
    k1 = p[2] * q[0] - p[0] * q[2]
    k2 = p[0] * q[1] - p[1] * q[0]
    det = k0 * k0 + k1 * k1 + k2 * k2 + eps2d * (pp + qq) + eps2d * eps2d
    return pp + eps2d, b, qq + eps2d, det


@kernel(inline=True)
def screen_radius(a, c, det, u, v, camera):
    """3DGS's radius (px): 3 σ of the longer axis, rounded up; 0 if its square misses the grid of 16×16 tiles.

    Density control counts a Gaussian as seen when this is above zero, whatever its opacity.
    """
    mid = HALF * (a + c)
    radius = math.ceil(F(3) * math.sqrt(mid + math.sqrt(max(F(0.1), mid * mid - det))))
    width = F(16) * math.ceil(camera[22] / F(16))
    height = F(16) * math.ceil(camera[23] / F(16))
    x, y = u - HALF, v - HALF  # 3DGS counts pixel centres as whole numbers
    if x + radius < ONE or y + radius < ONE or x - radius >= width or y - radius >= height:
        return ZERO
    return radius
