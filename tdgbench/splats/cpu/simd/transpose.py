"""Transposes of LANES × LANES floats: rows in memory become registers of columns, and back.

Offsets and strides count floats; `rows` and `k` are as in `tdgbench.splats.cpu.simd.memory.gather`.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tdgbench.splats.cpu.simd.registers import FLOATS, LANES

_INDEX, _LONG = ir.IntType(32), ir.IntType(64)
_REGISTER = 4 * LANES  # bytes


def _transposed(builder, registers: list) -> list:
    """Registers of the columns of a square, by swapping blocks of half the size off its diagonal, then smaller ones."""
    mask_type = ir.VectorType(_INDEX, LANES)
    step = LANES // 2
    while step >= 1:
        upper = ir.Constant(mask_type, [lane if not lane & step else LANES + lane - step for lane in range(LANES)])
        lower = ir.Constant(mask_type, [lane + step if not lane & step else LANES + lane for lane in range(LANES)])
        for i in range(LANES):
            if not i & step:
                a, b = registers[i], registers[i + step]
                registers[i] = builder.shuffle_vector(a, b, upper)
                registers[i + step] = builder.shuffle_vector(a, b, lower)
        step //= 2
    return registers


def _pointer(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), FLOATS.as_pointer())


def _at(builder, first, number: int, stride):
    return builder.add(first, builder.mul(_LONG(number), stride))


@intrinsic
def gather_block(typing_context, values, rows, k, stride, column, out, at):
    """out[at + c LANES + l] = values[rows[k + l] · stride + column + c] for c, l < LANES; `at` on register bounds.

    values and out are float32, rows int32, all 1-D.
    """

    def generate(context, builder, signature, args):
        index = context.make_array(signature.args[1])(context, builder, args[1]).data
        registers = []
        for lane in range(LANES):
            row = builder.sext(builder.load(builder.gep(index, [builder.add(args[2], _LONG(lane))])), _LONG)
            place = builder.add(builder.mul(row, args[3]), args[4])
            source = _pointer(context, builder, signature.args[0], args[0], place)
            registers.append(builder.load(source, align=4))
        for c, register in enumerate(_transposed(builder, registers)):
            place = builder.add(args[6], _LONG(c * LANES))
            builder.store(register, _pointer(context, builder, signature.args[5], args[5], place), align=_REGISTER)
        return context.get_dummy_value()

    long = types.int64
    return types.void(values, rows, long, long, long, out, long), generate


@intrinsic
def turn_block(typing_context, block, at, step, out, first, stride):
    """out[first + l · stride + c] = block[at + c · step + l] for c, l < LANES; float32, 1-D, at any offset."""

    def generate(context, builder, signature, args):
        registers = [
            builder.load(
                _pointer(context, builder, signature.args[0], args[0], _at(builder, args[1], c, args[2])), align=4
            )
            for c in range(LANES)
        ]
        for lane, register in enumerate(_transposed(builder, registers)):
            target = _pointer(context, builder, signature.args[3], args[3], _at(builder, args[4], lane, args[5]))
            builder.store(register, target, align=4)
        return context.get_dummy_value()

    long = types.int64
    return types.void(block, long, long, out, long, long), generate
