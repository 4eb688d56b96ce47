"""Reductions of the lanes of SIMD values, always in the same order."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tdgbench.splats.cpu.simd.registers import LANES, constant, mask, vec

_INDEX = ir.IntType(32)


def _shuffle(builder, a, b, index):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INDEX, len(index)), index))


@intrinsic
def any_positive(typing_context, x):
    """True if any lane is above zero."""

    def generate(context, builder, signature, args):
        bits = builder.bitcast(builder.fcmp_ordered(">", args[0], constant(0.0)), ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.IntType(LANES)(0))

    return types.boolean(vec), generate


@intrinsic
def any_bit(typing_context, x):
    """True unless all bits of all lanes are zero."""

    def generate(context, builder, signature, args):
        whole = ir.IntType(32 * LANES)
        return builder.icmp_unsigned("!=", builder.bitcast(args[0], whole), whole(0))

    return types.boolean(vec), generate


@intrinsic
def lane_bits(typing_context, condition):
    """A mask as a number: bit l is lane l."""

    def generate(context, builder, signature, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))

    return types.uint64(mask), generate


@intrinsic
def lane_sum(typing_context, x):
    """The sum over the lanes, always in the same order."""

    def generate(context, builder, signature, args):
        value, width = args[0], LANES // 2
        while width >= 1:
            low, high = list(range(width)), list(range(width, 2 * width))
            value = builder.fadd(_shuffle(builder, value, value, low), _shuffle(builder, value, value, high))
            width //= 2
        return builder.extract_element(value, _INDEX(0))

    return types.float32(vec), generate


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
                _shuffle(builder, vectors[i], vectors[i + 1], low),
                _shuffle(builder, vectors[i], vectors[i + 1], high),
            )
            for i in halves
        ]
        width //= 2
    total = vectors[0]
    while width >= 1:
        total = builder.fadd(total, _shuffle(builder, total, total, [i ^ width for i in range(LANES)]))
        width //= 2
    return total, [labels[0].index(i) for i in range(max(labels[0]) + 1)]


@intrinsic
def lane_sums_of_4(typing_context, v0, v1, v2, v3):
    """The lane sums of four vectors, in lanes 0 to 3 of the result."""

    def generate(context, builder, signature, args):
        total, places = _sum_tree(builder, list(args))
        return _shuffle(builder, total, total, places + [0] * (LANES - 4))

    return vec(*[vec] * 4), generate


@intrinsic
def lane_sums_of_8(typing_context, v0, v1, v2, v3, v4, v5, v6, v7):
    """The lane sums of eight vectors, in lanes 0 to 7 of the result: one shuffle tree instead of eight."""

    def generate(context, builder, signature, args):
        total, places = _sum_tree(builder, list(args))
        return _shuffle(builder, total, total, places + [0] * (LANES - 8))

    return vec(*[vec] * 8), generate
