"""LANES Gaussians as registers: their activated parameters, and their projection to the image by EWA splatting (Zwicker
et al. 2001, as used by 3DGS).

Helpers of the kernels: numbers are registers unless named scalars, vectors are tuples of them; `camera` is a
`PackedCamera`. Parameters are first collected in `gathered`, (GATHERED · LANES,) float32: column c of
`tdgbench.splats.gaussians` at c · LANES. `rows` (n,) int32 and `k` name the Gaussians rows[k], rows[k + 1], …
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.types import MAX_CHANNELS
from tdgbench.splats.cpu.simd.memory import gather_block, load
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    broadcast,
    divide,
    divide_doubles,
    exp2,
    greater,
    greater_equal,
    is_nan,
    log2,
    maximum,
    minimum,
    round_up,
    select,
    square_root,
    widen,
)
from tdgbench.splats.gaussians import COLORS_AT, MEANS_AT, QUATS_AT, SCALES_AT, padded

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
FAR_AWAY = F(1e9)  # px: beyond it, whole numbers of pixels make no sense
LOG2_E = F(math.log2(math.e))
LARGEST_EXPONENT = F(126)
GATHERED = padded(COLORS_AT + 16 * MAX_CHANNELS)  # registers: a Gaussian of degree 3
SHORTEST = F(1e-12)  # quaternions are divided by no less, as torch does


@kernel(inline=True)
def exponential(x):
    """e^x, clamped to 2^±126; NaN stays NaN."""
    return select(is_nan(x), x, exp2(minimum(maximum(x * LOG2_E, -LARGEST_EXPONENT), LARGEST_EXPONENT)))


@kernel(inline=True)
def collect(parameters, rows, k, columns, gathered):
    """Fill `gathered` with the Gaussians rows[k …] of `Parameters`, as many columns as `Columns` uses."""
    values, stride = parameters.values, parameters.stride
    for c in range(0, columns.used, LANES):
        gather_block(values, rows, k, stride, c, gathered, c * LANES)


@kernel(inline=True)
def color_column(channels, b, c):
    """The column of coefficient b of channel c of `Channels`."""
    columns = channels.columns
    if c < columns.split:
        return columns.first + b * columns.split + c
    return columns.second + b * (channels.colors - columns.split) + c - columns.split


@kernel(inline=True)
def gathered_columns(gathered, c):
    """Columns c, c + 1, c + 2."""
    return load(gathered, c * LANES), load(gathered, (c + 1) * LANES), load(gathered, (c + 2) * LANES)


@kernel(inline=True)
def deviations(gathered, raw):
    """Standard deviations along the three axes, world units; `raw`: `gathered` holds their natural logarithms."""
    s0, s1, s2 = gathered_columns(gathered, SCALES_AT)
    if raw:
        s0, s1, s2 = exponential(s0), exponential(s1), exponential(s2)
    return s0, s1, s2


@kernel(inline=True)
def opacity_and_log2(gathered, column, raw):
    """Opacity and its log2; `raw`: `gathered` holds the logit x: o = 1 / (1 + e^−x), log2 o = −log2(1 + e^−x)."""
    opacity = load(gathered, column * LANES)
    if raw:
        inverse = exponential(ZERO - opacity) + ONE
        opacity = divide(ONE, inverse)
        logarithm = ZERO - log2(inverse)
    else:
        logarithm = log2(opacity)
    return opacity, logarithm


@kernel(inline=True)
def rotation(gathered):
    """Rows of the rotation matrix of a quaternion (wxyz), its normalised parts, and 1 / |quaternion|."""
    w = load(gathered, QUATS_AT * LANES)
    x, y, z = gathered_columns(gathered, QUATS_AT + 1)
    length = square_root(w * w + x * x + y * y + z * z)
    n = divide(ONE, select(greater(broadcast(SHORTEST), length), broadcast(SHORTEST), length))
    w, x, y, z = w * n, x * n, y * n, z * n
    r0 = (ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y))
    r1 = (TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x))
    r2 = (TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y))
    return (r0, r1, r2), (w, x, y, z), n


@kernel(inline=True)
def dot(a, b):
    """Dot product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(inline=True)
def from_camera(mean, camera):
    """World vectors from the camera to the mean. Far from the origin R m + t would cancel; this keeps its digits."""
    mx, my, mz = mean
    cx, cy, cz = camera.centre
    rx, ry, rz = camera.centre_rest
    return (mx - cx) - rx, (my - cy) - ry, (mz - cz) - rz


@kernel(inline=True)
def camera_point(mean, camera):
    """The mean in camera coordinates."""
    toward = from_camera(mean, camera)
    return dot(toward, camera.x_axis), dot(toward, camera.y_axis), dot(toward, camera.z_axis)


@kernel(inline=True)
def ray_limits(camera):
    """Left, right, top, bottom (scalars) tan at which rays are clamped: 1.3 × the field of view (3DGS).

    Beyond, the linearisation would explode.
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    margin_x, margin_y = F(0.15) * camera.width / fx, F(0.15) * camera.height / fy
    return (
        -cx / fx - margin_x,
        (camera.width - cx) / fx + margin_x,
        -cy / fy - margin_y,
        (camera.height - cy) / fy + margin_y,
    )


@kernel(inline=True)
def jacobian_row(s, axis, t, z_axis):
    """Row of J·R: px by which u or v moves per world unit of the mean; s: focal length / z, t: tan of a clamped ray."""
    return s * (axis[0] - t * z_axis[0]), s * (axis[1] - t * z_axis[1]), s * (axis[2] - t * z_axis[2])


@kernel(inline=True)
def along_axes(j, rotation):
    """j · (columns of the rotation): a Jacobian row in the Gaussian's axes."""
    r0, r1, r2 = rotation
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
    pp, qq, b = dot(p, p), dot(q, q), dot(p, q)
    k0 = p[1] * q[2] - p[2] * q[1]
    k1 = p[2] * q[0] - p[0] * q[2]
    k2 = p[0] * q[1] - p[1] * q[0]
    det = k0 * k0 + k1 * k1 + k2 * k2 + (pp + qq) * eps2d + eps2d * eps2d
    return pp + eps2d, b, qq + eps2d, det


class Footprint(NamedTuple):
    """Projection of a Gaussian, and the steps that its gradient needs; registers and tuples of them."""

    mean: tuple  # world
    scales: tuple  # standard deviations, world units
    axes: tuple  # rows of the rotation matrix
    quat: tuple  # wxyz, normalised
    per_length: float  # 1 / |quaternion|
    point: tuple  # x, y, z in camera coordinates
    rz: float  # 1 / z
    ray: tuple  # tx, ty: tan of the viewing ray, clamped
    ja: tuple  # rows of J·R, px per world unit
    jb: tuple
    p_unit: tuple  # the same along the Gaussian's axes
    q_unit: tuple
    p: tuple  # times the deviations, px
    q: tuple
    covariance: tuple  # a, b, c of [[a, b], [b, c]], px²
    det: float  # its determinant, px⁴


@kernel(inline=True)
def footprint_of(gathered, raw, camera):
    """Footprint of the Gaussians in `gathered`; raw: before activation.

    The mean is loaded last: LLVM orders the terms of a sum by their loads, and so chooses which products are fused.
    """
    axes, quat, per_length = rotation(gathered)
    s0, s1, s2 = deviations(gathered, raw)
    mean = gathered_columns(gathered, MEANS_AT)
    x, y, z = camera_point(mean, camera)
    rz = divide(ONE, z)
    left, right, top, bottom = ray_limits(camera)
    tx, ty = minimum(maximum(x * rz, left), right), minimum(maximum(y * rz, top), bottom)
    ja = jacobian_row(rz * camera.fx, camera.x_axis, tx, camera.z_axis)
    jb = jacobian_row(rz * camera.fy, camera.y_axis, ty, camera.z_axis)
    p_unit, q_unit = along_axes(ja, axes), along_axes(jb, axes)
    p = (p_unit[0] * s0, p_unit[1] * s1, p_unit[2] * s2)
    q = (q_unit[0] * s0, q_unit[1] * s1, q_unit[2] * s2)
    a, b, c, det = covariance_2d(p, q, camera.eps2d)
    scales, point, covariance = (s0, s1, s2), (x, y, z), (a, b, c)
    return Footprint(
        mean, scales, axes, quat, per_length, point, rz, (tx, ty), ja, jb, p_unit, q_unit, p, q, covariance, det
    )


@kernel(inline=True)
def exact_image_point(mean, camera):
    """u and v of the means in double precision: in single, 3e-5 px are lost at 600, which alpha shows."""
    D = np.float64
    mx = widen(mean[0]) - D(camera.centre[0]) - D(camera.centre_rest[0])
    my = widen(mean[1]) - D(camera.centre[1]) - D(camera.centre_rest[1])
    mz = widen(mean[2]) - D(camera.centre[2]) - D(camera.centre_rest[2])
    x = mx * D(camera.x_axis[0]) + my * D(camera.x_axis[1]) + mz * D(camera.x_axis[2])
    y = mx * D(camera.y_axis[0]) + my * D(camera.y_axis[1]) + mz * D(camera.y_axis[2])
    z = mx * D(camera.z_axis[0]) + my * D(camera.z_axis[1]) + mz * D(camera.z_axis[2])
    rz = divide_doubles(1.0, z)
    return x * D(camera.fx) * rz + D(camera.cx), y * D(camera.fy) * rz + D(camera.cy)


@kernel(inline=True)
def screen_radius(a, c, det, u, v, camera):
    """3DGS's radius (px): 3 σ of the longer axis, rounded up; 0 if its square misses the grid of 16×16 tiles.

    Density control counts a Gaussian as visible when this is above zero, whatever its opacity.
    """
    mid = HALF * (a + c)
    longest = square_root(mid + square_root(maximum(mid * mid - det, broadcast(F(0.1)))))
    radius = round_up(F(3) * longest)
    width = broadcast(F(16) * math.ceil(camera.width / F(16)))
    height = broadcast(F(16) * math.ceil(camera.height / F(16)))
    x, y = u - HALF, v - HALF  # 3DGS counts pixel centres as whole numbers
    zero, one = broadcast(ZERO), broadcast(ONE)
    radius = select(greater(one, x + radius), zero, radius)
    radius = select(greater(one, y + radius), zero, radius)
    radius = select(greater_equal(x - radius, width), zero, radius)
    radius = select(greater_equal(y - radius, height), zero, radius)
    return minimum(radius, broadcast(FAR_AWAY))
