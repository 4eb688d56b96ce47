"""The parameters of LANES Gaussians as registers, activated.

`rows` (n,) int32 and `k` name the Gaussians rows[k], rows[k + 1], …; `parameter`, `scales`, … are `Columns`.
"""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import gather, gather_3
from tdgbench.splats.cpu.simd.powers import exp2, log2
from tdgbench.splats.cpu.simd.registers import broadcast, divide, greater, is_nan, maximum, minimum, select, square_root

F = np.float32
ZERO, ONE, TWO = F(0), F(1), F(2)
LOG2_E = F(math.log2(math.e))
LARGEST_EXPONENT = F(126)
SHORTEST = F(1e-12)  # quaternions are divided by no less, as torch does


@kernel(inline=True)
def exponential(x):
    """e^x, clamped to 2^±126; NaN stays NaN."""
    return select(is_nan(x), x, exp2(minimum(maximum(x * LOG2_E, -LARGEST_EXPONENT), LARGEST_EXPONENT)))


@kernel(inline=True)
def column(parameter, rows, k, offset):
    """Column `offset` of a parameter (Columns)."""
    return gather(parameter.values, rows, k, parameter.stride, parameter.first + offset)


@kernel(inline=True)
def three_columns(parameter, rows, k, offset):
    """Columns offset, offset + 1, offset + 2 of a parameter (Columns)."""
    return gather_3(parameter.values, rows, k, parameter.stride, parameter.first + offset)


@kernel(inline=True)
def deviations(scales, rows, k, raw):
    """Standard deviations along the three axes, world units; `raw`: scales holds their natural logarithms."""
    s0, s1, s2 = three_columns(scales, rows, k, 0)
    if raw:
        s0, s1, s2 = exponential(s0), exponential(s1), exponential(s2)
    return s0, s1, s2


@kernel(inline=True)
def opacity_and_log2(opacities, rows, k, raw):
    """Opacity and its log2; `raw`: opacities holds the logit x: o = 1 / (1 + e^−x), log2 o = −log2(1 + e^−x)."""
    opacity = column(opacities, rows, k, 0)
    if raw:
        inverse = exponential(ZERO - opacity) + ONE
        opacity = divide(ONE, inverse)
        logarithm = ZERO - log2(inverse)
    else:
        logarithm = log2(opacity)
    return opacity, logarithm


@kernel(inline=True)
def rotation(quats, rows, k):
    """Rows of the rotation matrix of a quaternion (wxyz), its normalised parts, and 1 / |quaternion|."""
    w = column(quats, rows, k, 0)
    x, y, z = three_columns(quats, rows, k, 1)
    length = square_root(w * w + x * x + y * y + z * z)
    n = divide(ONE, select(greater(broadcast(SHORTEST), length), broadcast(SHORTEST), length))
    w, x, y, z = w * n, x * n, y * n, z * n
    r0 = (ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y))
    r1 = (TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x))
    r2 = (TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y))
    return (r0, r1, r2), (w, x, y, z), n
