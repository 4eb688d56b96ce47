"""Projection of 3-D Gaussians to 2-D ones (EWA splatting; Zwicker et al. 2001, as used by 3DGS), LANES at a time.

Helpers of the kernels: numbers are registers unless named scalars, vectors are tuples of them; `camera` is a `Camera`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import MEANS_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.parameters import deviations, gathered_columns, rotation
from tdgbench.splats.cpu.simd.registers import (
    broadcast,
    divide,
    divide_doubles,
    greater,
    greater_equal,
    maximum,
    minimum,
    round_up,
    select,
    square_root,
    widen,
)

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
FAR_AWAY = F(1e9)  # px: beyond it, whole numbers of pixels make no sense


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
    mx, my, mz = from_camera(mean, camera)
    x = mx * camera.x_axis[0] + my * camera.x_axis[1] + mz * camera.x_axis[2]
    y = mx * camera.y_axis[0] + my * camera.y_axis[1] + mz * camera.y_axis[2]
    z = mx * camera.z_axis[0] + my * camera.z_axis[1] + mz * camera.z_axis[2]
    return x, y, z


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
def clamped_ray(x, y, rz, camera):
    """tan of the viewing ray, clamped."""
    left, right, top, bottom = ray_limits(camera)
    return minimum(maximum(x * rz, left), right), minimum(maximum(y * rz, top), bottom)


@kernel(inline=True)
def jacobian_rows(tx, ty, rz, camera):
    """Rows of J·R: px by which u and v move per world unit of the mean; tx, ty: clamped ray, rz = 1 / z."""
    sx, sy = rz * camera.fx, rz * camera.fy
    ja = (
        sx * (camera.x_axis[0] - tx * camera.z_axis[0]),
        sx * (camera.x_axis[1] - tx * camera.z_axis[1]),
        sx * (camera.x_axis[2] - tx * camera.z_axis[2]),
    )
    jb = (
        sy * (camera.y_axis[0] - ty * camera.z_axis[0]),
        sy * (camera.y_axis[1] - ty * camera.z_axis[1]),
        sy * (camera.y_axis[2] - ty * camera.z_axis[2]),
    )
    return ja, jb


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
    pp = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    qq = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
    b = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
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
    tx, ty = clamped_ray(x, y, rz, camera)
    ja, jb = jacobian_rows(tx, ty, rz, camera)
    p_unit, q_unit = along_axes(ja, axes), along_axes(jb, axes)
    p = (p_unit[0] * s0, p_unit[1] * s1, p_unit[2] * s2)
    q = (q_unit[0] * s0, q_unit[1] * s1, q_unit[2] * s2)
    a, b, c, det = covariance_2d(p, q, camera.eps2d)
    return Footprint(
        mean,
        (s0, s1, s2),
        axes,
        quat,
        per_length,
        (x, y, z),
        rz,
        (tx, ty),
        ja,
        jb,
        p_unit,
        q_unit,
        p,
        q,
        (a, b, c),
        det,
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
