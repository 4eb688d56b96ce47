"""Registers of LANES doubles, for what single precision would spoil: `+`, `-` and `*`, also with float64 scalars."""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from tdgbench.splats.cpu.simd.registers import FAST, FLOATS, LANES, VectorType, vec

DOUBLES = ir.VectorType(ir.DoubleType(), LANES)

doubles = VectorType("doubles", DOUBLES)


def _operand(builder, value, value_type):
    """The value as a register; a float64 scalar is repeated."""
    if value_type == doubles:
        return value
    empty = ir.Constant(DOUBLES, ir.Undefined)
    first = builder.insert_element(empty, value, ir.IntType(32)(0))
    return builder.shuffle_vector(first, empty, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


def _is_operand(t: types.Type) -> bool:
    return t in (doubles, types.float64)


def _arithmetic(instruction: str, flags: tuple[str, ...] = FAST):
    @intrinsic
    def operation(typing_context, x, y):
        def generate(context, builder, signature, args):
            a, b = (_operand(builder, v, t) for v, t in zip(args, signature.args, strict=True))
            return getattr(builder, instruction)(a, b, flags=flags)

        if _is_operand(x) and _is_operand(y):
            return doubles(x, y), generate
        return None

    return operation


_add, _sub, _mul = _arithmetic("fadd"), _arithmetic("fsub"), _arithmetic("fmul")
over = _arithmetic("fdiv", ())
over.__doc__ = "x / y, correctly rounded; x and y are registers or float64 scalars."


def _overload_operator(python_operator, function) -> None:
    @overload(python_operator)
    def typed(x, y):
        if doubles in (x, y) and _is_operand(x) and _is_operand(y):
            return lambda x, y: function(x, y)
        return None


for _operator, _function in ((operator.add, _add), (operator.sub, _sub), (operator.mul, _mul)):
    _overload_operator(_operator, _function)


@intrinsic
def widen(typing_context, x):
    """The floats of a register as doubles."""
    return doubles(vec), lambda context, builder, signature, args: builder.fpext(args[0], DOUBLES)


@intrinsic
def narrow(typing_context, x):
    """Doubles rounded to floats."""
    return vec(doubles), lambda context, builder, signature, args: builder.fptrunc(args[0], FLOATS)
