"""2^x and log2 x on registers."""

from __future__ import annotations

import numpy as np
from numba.extending import intrinsic

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load
from tdgbench.splats.cpu.simd.registers import BITS, FLOATS, LANES, bits, constant, on_registers, vec

# 2^x = 2^n 2^r, r in [-1/2, 1/2]: minimax polynomial of 2^r to 2.5e-7 relative, from the highest power down.
EXP2 = (0.00132764718, 0.00967554133, 0.0555071327, 0.240221197, 0.693146967, 1.00000007)
ROOT_HALF = 0x3F3504F3  # the bits of √½


def _power_of_two(builder, x, coefficients):
    """2^x for |x| < 126, given the polynomial's coefficients as registers; out of range is garbage to be masked."""
    exact = ("contract",)
    magic = constant(12582912.0)  # 1.5 * 2^23: adding it rounds to the nearest whole number
    shifted = builder.fadd(x, magic)
    exponent = builder.shl(builder.bitcast(shifted, BITS), bits(23))
    rest = builder.fsub(x, builder.fsub(shifted, magic))
    square = builder.fmul(rest, rest)
    pairs = [
        builder.fadd(builder.fmul(high, rest, flags=exact), low, flags=exact)
        for high, low in zip(coefficients[::2], coefficients[1::2], strict=True)
    ]
    result = pairs[0]
    for pair in pairs[1:]:
        result = builder.fadd(builder.fmul(result, square, flags=exact), pair, flags=exact)
    return builder.bitcast(builder.add(builder.bitcast(result, BITS), exponent), FLOATS)


exp2 = on_registers(
    vec,
    lambda builder, x: _power_of_two(builder, x, [constant(value) for value in EXP2]),
    "2^x to a relative error of 2.5e-7 for |x| < 126; out of range is garbage that the caller masks.",
)


@intrinsic
def exp2_by(typing_context, x, coefficients):
    """As `exp2`, with a tuple of registers for coefficients, from the highest power down.

    The compiler broadcasts a constant at every use; a coefficient in memory is an operand there.
    """

    def generate(context, builder, signature, args):
        registers = [builder.extract_value(args[1], i) for i in range(len(coefficients))]
        return _power_of_two(builder, args[0], registers)

    return vec(vec, coefficients), generate


def _log2(builder, x):
    """x = 2^e m with m in [√½, √2);  log2 m = 2 / ln 2 · atanh(s), s = (m − 1) / (m + 1), as a series to s⁹."""
    exact = ("contract",)
    exponent = builder.ashr(builder.sub(builder.bitcast(x, BITS), bits(ROOT_HALF)), bits(23))
    m = builder.bitcast(builder.sub(builder.bitcast(x, BITS), builder.shl(exponent, bits(23))), FLOATS)
    one = constant(1.0)
    s = builder.fdiv(builder.fsub(m, one), builder.fadd(m, one))
    square = builder.fmul(s, s)
    series = constant(1 / 9)
    for k in (7, 5, 3):
        series = builder.fadd(builder.fmul(series, square, flags=exact), constant(1 / k), flags=exact)
    scaled = builder.fmul(s, constant(2.8853900817779268))
    tail = builder.fmul(builder.fmul(series, square), scaled)
    return builder.fadd(builder.sitofp(exponent, FLOATS), builder.fadd(scaled, tail))


log2 = on_registers(
    vec, _log2, "log2 of a positive, normal x, to an absolute error of 1e-7 near 1 and a relative one of 2e-7 beyond."
)


def _coefficients() -> np.ndarray:
    table = empty_aligned((len(EXP2), LANES), np.float32)
    table[:] = np.array(EXP2, np.float32)[:, None]
    return table.reshape(-1)


COEFFICIENTS = _coefficients()  # (6 · LANES,) float32: each coefficient of `exp2` as a register


@kernel(inline=True)
def exp2_in_memory(x, table):
    """2^x to 2.5e-7 relative for a register x, |x| < 126; table is COEFFICIENTS."""
    first = (load(table, 0), load(table, LANES), load(table, 2 * LANES))
    return exp2_by(x, (*first, load(table, 3 * LANES), load(table, 4 * LANES), load(table, 5 * LANES)))
