"""Reductions of the lanes of SIMD values, and sums over rows of floats, always in the same order.

A sum that the compiler may reorder comes out differently, in its last bits, where it is compiled in another context:
in the process that compiles a kernel, and in one that loads it from the machine-code cache.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import load_anywhere
from tdgbench.splats.cpu.simd.registers import LANES, absolute, broadcast, constant, on_registers, vec

_INDEX = ir.IntType(32)
U, ZERO = np.uint64, np.float32(0)


def _shuffle(builder, a, b, index):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INDEX, len(index)), index))


def _is_any_bit_set(builder, x, bits: int):
    whole = ir.IntType(bits)
    return builder.icmp_unsigned("!=", builder.bitcast(x, whole), whole(0))


any_positive = on_registers(
    types.boolean,
    lambda builder, x: _is_any_bit_set(builder, builder.fcmp_ordered(">", x, constant(0.0)), LANES),
    "True if any lane is above zero.",
)
any_bit = on_registers(
    types.boolean, lambda builder, x: _is_any_bit_set(builder, x, 32 * LANES), "True unless all bits are zero."
)
lane_bits = on_registers(
    types.uint64,
    lambda builder, x: builder.zext(builder.bitcast(x, ir.IntType(LANES)), ir.IntType(64)),
    "A mask as a number: bit l is lane l.",
)


def _lane_sum(builder, value):
    width = LANES // 2
    while width >= 1:
        low, high = list(range(width)), list(range(width, 2 * width))
        value = builder.fadd(_shuffle(builder, value, value, low), _shuffle(builder, value, value, high))
        width //= 2
    return builder.extract_element(value, _INDEX(0))


lane_sum = on_registers(types.float32, _lane_sum, "The sum over the lanes of a register of floats.")


def _sum_tree(builder, vectors):
    """Lane sums of a power of two of vectors in one vector, and the lane where each ends up."""
    width, labels = LANES // 2, [[i] * LANES for i in range(len(vectors))]
    while len(vectors) > 1:
        low, high = [], []
        for start in range(0, LANES, 2 * width):
            for base in (start, LANES + start):
                low += range(base, base + width)
                high += range(base + width, base + 2 * width)
        halves = range(0, len(vectors), 2)
        labels = [[(labels[i] + labels[i + 1])[k] for k in low] for i in halves]
        vectors = [
            builder.fadd(
                _shuffle(builder, vectors[i], vectors[i + 1], low), _shuffle(builder, vectors[i], vectors[i + 1], high)
            )
            for i in halves
        ]
        width //= 2
    total = vectors[0]
    while width >= 1:
        total = builder.fadd(total, _shuffle(builder, total, total, [i ^ width for i in range(LANES)]))
        width //= 2
    return total, [labels[0].index(i) for i in range(max(labels[0]) + 1)]


def _lane_sums(builder, *vectors):
    total, places = _sum_tree(builder, list(vectors))
    return _shuffle(builder, total, total, places + [0] * (LANES - len(vectors)))


# One shuffle tree instead of one for each register. The sums are in the first lanes of the result.
lane_sums_of_4 = on_registers(vec, lambda builder, a, b, c, d: _lane_sums(builder, a, b, c, d))
lane_sums_of_8 = on_registers(vec, lambda builder, a, b, c, d, e, f, g, h: _lane_sums(builder, a, b, c, d, e, f, g, h))


@kernel(inline=True)
def row_sum(values):
    """Σ values (columns,)."""
    count = U(values.shape[0])
    whole = count - count % U(LANES)
    partial = broadcast(ZERO)
    for x in range(U(0), whole, U(LANES)):
        partial = partial + load_anywhere(values, x)
    total = lane_sum(partial)
    for x in range(whole, count):
        total += values[x]
    return total


@kernel(inline=True)
def difference_sum(a, b, v, w):
    """Σ v w |a − b| of rows a and b (columns,), with the weights v and w of their values (columns,), or None."""
    count = U(a.shape[0])
    whole = count - count % U(LANES)
    partial = broadcast(ZERO)
    for x in range(U(0), whole, U(LANES)):
        difference = absolute(load_anywhere(a, x) - load_anywhere(b, x))
        if v is None:
            partial = partial + difference
        else:
            partial = partial + load_anywhere(v, x) * load_anywhere(w, x) * difference
    total = lane_sum(partial)
    for x in range(whole, count):
        if v is None:
            total += abs(a[x] - b[x])
        else:
            total += v[x] * w[x] * abs(a[x] - b[x])
    return total
