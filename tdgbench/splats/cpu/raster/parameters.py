"""The parameters of LANES Gaussians as registers, activated.

They are first collected in `gathered`, (GATHERED · LANES,) float32: column c of `tdgbench.splats.columns` at c · LANES.
`rows` (n,) int32 and `k` name the Gaussians rows[k], rows[k + 1], …
"""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.columns import COLORS_AT, OPACITY_AT, QUATS_AT, SCALES_AT, padded
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import gather_block, load
from tdgbench.splats.cpu.simd.powers import exp2, log2
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    broadcast,
    divide,
    greater,
    is_nan,
    maximum,
    minimum,
    select,
    square_root,
)

F = np.float32
ZERO, ONE, TWO = F(0), F(1), F(2)
LOG2_E = F(math.log2(math.e))
LARGEST_EXPONENT = F(126)
GATHERED = padded(COLORS_AT + 16 * 4)  # registers: a Gaussian of degree 3 with four channels
SHORTEST = F(1e-12)  # quaternions are divided by no less, as torch does


@kernel(inline=True)
def exponential(x):
    """e^x, clamped to 2^±126; NaN stays NaN."""
    return select(is_nan(x), x, exp2(minimum(maximum(x * LOG2_E, -LARGEST_EXPONENT), LARGEST_EXPONENT)))


@kernel(inline=True)
def collect(parameters, rows, k, colors, gathered):
    """Fill `gathered` with the Gaussians rows[k …] of `Parameters`, `colors` numbers of their colours."""
    values, stride = parameters.values, parameters.stride
    for c in range(0, COLORS_AT + colors, LANES):
        gather_block(values, rows, k, stride, c, gathered, c * LANES)


@kernel(inline=True)
def gathered_column(gathered, c):
    """Column c."""
    return load(gathered, c * LANES)


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
def opacity_and_log2(gathered, raw):
    """Opacity and its log2; `raw`: `gathered` holds the logit x: o = 1 / (1 + e^−x), log2 o = −log2(1 + e^−x)."""
    opacity = gathered_column(gathered, OPACITY_AT)
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
    w = gathered_column(gathered, QUATS_AT)
    x, y, z = gathered_columns(gathered, QUATS_AT + 1)
    length = square_root(w * w + x * x + y * y + z * z)
    n = divide(ONE, select(greater(broadcast(SHORTEST), length), broadcast(SHORTEST), length))
    w, x, y, z = w * n, x * n, y * n, z * n
    r0 = (ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y))
    r1 = (TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x))
    r2 = (TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y))
    return (r0, r1, r2), (w, x, y, z), n
