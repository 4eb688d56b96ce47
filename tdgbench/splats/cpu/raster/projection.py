"""Projection of 3-D Gaussians to 2-D ones (EWA splatting; Zwicker et al. 2001, as used by 3DGS), LANES at a time.

The camera is one float32 array: [0:12] the rows of world-to-camera [R | t] (t is not read), [12:16] fx fy cx cy,
[16:19] camera centre, [19] near, [20] far, [21] eps2d, [22] width, [23] height, [24:27] what float32 leaves of the
centre. Pixel centres lie at whole numbers + 1/2.
"""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import gather, gather_3
from tdgbench.splats.cpu.simd.registers import (
    divide,
    exp2,
    greater,
    greater_equal,
    is_nan,
    log2,
    maximum,
    minimum,
    round_up,
    select,
    splat,
    square_root,
)

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
CAMERA_SIZE = 27
LOG2_E = F(math.log2(math.e))
LARGEST_EXPONENT = F(126)
SHORTEST = F(1e-12)  # quaternions are divided by no less, as torch does
FAR_AWAY = F(1e9)  # px: beyond it, whole numbers of pixels make no sense


@kernel(inline=True)
def exponential(x):
    """e^x, held within 2^±126; NaN stays NaN."""
    return select(is_nan(x), x, exp2(minimum(maximum(x * LOG2_E, -LARGEST_EXPONENT), LARGEST_EXPONENT)))


@kernel(inline=True)
def deviations(scales, rows, k, stride, column, raw):
    """Standard deviations along the three axes; `raw` stores their natural logarithms."""
    s0, s1, s2 = gather_3(scales, rows, k, stride, column)
    if raw:
        s0, s1, s2 = exponential(s0), exponential(s1), exponential(s2)
    return s0, s1, s2


@kernel(inline=True)
def opacity_and_log2(opacities, rows, k, stride, column, raw):
    """Opacity and its log2; `raw` stores the logit: o = 1 / (1 + e^−x), log2 o = −log2(1 + e^−x)."""
    opacity = gather(opacities, rows, k, stride, column)
    if raw:
        inverse = exponential(ZERO - opacity) + ONE
        opacity = divide(ONE, inverse)
        logarithm = ZERO - log2(inverse)
    else:
        logarithm = log2(opacity)
    return opacity, logarithm


@kernel(inline=True)
def from_camera(mean, camera):
    """World vectors from the camera to the mean. Far from the origin R m + t would cancel; this keeps its digits."""
    mx, my, mz = mean
    return (mx - camera[16]) - camera[24], (my - camera[17]) - camera[25], (mz - camera[18]) - camera[26]


@kernel(inline=True)
def camera_point(mean, camera):
    """The mean in camera coordinates."""
    mx, my, mz = from_camera(mean, camera)
    x = mx * camera[0] + my * camera[1] + mz * camera[2]
    y = mx * camera[4] + my * camera[5] + mz * camera[6]
    z = mx * camera[8] + my * camera[9] + mz * camera[10]
    return x, y, z


@kernel(inline=True)
def rotation(quats, rows, k, stride, column):
    """Rows of the rotation matrix of a quaternion (wxyz), its normalised parts, and 1 / |quaternion|."""
    w = gather(quats, rows, k, stride, column)
    x, y, z = gather_3(quats, rows, k, stride, column + 1)
    length = square_root(w * w + x * x + y * y + z * z)
    n = divide(ONE, select(greater(splat(SHORTEST), length), splat(SHORTEST), length))
    w, x, y, z = w * n, x * n, y * n, z * n
    r0 = (ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y))
    r1 = (TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x))
    r2 = (TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y))
    return r0, r1, r2, (w, x, y, z), n


@kernel(inline=True)
def ray_limits(camera):
    """Where viewing rays are clamped: 1.3 × the field of view, where the linearisation would explode (3DGS)."""
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    margin_x, margin_y = F(0.15) * camera[22] / fx, F(0.15) * camera[23] / fy
    return (
        -cx / fx - margin_x,
        (camera[22] - cx) / fx + margin_x,
        -cy / fy - margin_y,
        (camera[23] - cy) / fy + margin_y,
    )


@kernel(inline=True)
def clamped_ray(x, y, rz, camera):
    """tan of the viewing ray, clamped."""
    left, right, top, bottom = ray_limits(camera)
    return minimum(maximum(x * rz, left), right), minimum(maximum(y * rz, top), bottom)


@kernel(inline=True)
def jacobian_rows(tx, ty, rz, camera):
    """Rows of J·R: how u and v move with the mean in world coordinates."""
    sx, sy = rz * camera[12], rz * camera[13]
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
    det = k0 * k0 + k1 * k1 + k2 * k2 + (pp + qq) * eps2d + eps2d * eps2d
    return pp + eps2d, b, qq + eps2d, det


@kernel()
def exact_image_point(mean_x, mean_y, mean_z, camera):
    """u and v of one mean (scalars) in double precision: in single, 3e-5 px are lost at 600, which alpha shows."""
    mx = np.float64(mean_x) - np.float64(camera[16]) - np.float64(camera[24])
    my = np.float64(mean_y) - np.float64(camera[17]) - np.float64(camera[25])
    mz = np.float64(mean_z) - np.float64(camera[18]) - np.float64(camera[26])
    x = np.float64(camera[0]) * mx + np.float64(camera[1]) * my + np.float64(camera[2]) * mz
    y = np.float64(camera[4]) * mx + np.float64(camera[5]) * my + np.float64(camera[6]) * mz
    z = np.float64(camera[8]) * mx + np.float64(camera[9]) * my + np.float64(camera[10]) * mz
    rz = 1.0 / z
    return (
        np.float64(camera[12]) * x * rz + np.float64(camera[14]),
        np.float64(camera[13]) * y * rz + np.float64(camera[15]),
    )


@kernel(inline=True)
def screen_radius(a, c, det, u, v, camera):
    """3DGS's radius (px): 3 σ of the longer axis, rounded up; 0 if its square misses the grid of 16×16 tiles.

    Density control counts a Gaussian as seen when this is above zero, whatever its opacity.
    """
    mid = HALF * (a + c)
    longest = square_root(mid + square_root(maximum(mid * mid - det, splat(F(0.1)))))
    radius = round_up(F(3) * longest)
    width = splat(F(16) * math.ceil(camera[22] / F(16)))
    height = splat(F(16) * math.ceil(camera[23] / F(16)))
    x, y = u - HALF, v - HALF  # 3DGS counts pixel centres as whole numbers
    zero, one = splat(ZERO), splat(ONE)
    radius = select(greater(one, x + radius), zero, radius)
    radius = select(greater(one, y + radius), zero, radius)
    radius = select(greater_equal(x - radius, width), zero, radius)
    radius = select(greater_equal(y - radius, height), zero, radius)
    return minimum(radius, splat(FAR_AWAY))
