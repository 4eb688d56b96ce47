"""An explicit SIMD float type for Numba: one value is a whole register of LANES float32.

Numba's auto-vectoriser is fragile (a harmless edit can cost a factor of six); an LLVM vector type is not. The same
source becomes AVX-512, AVX2, SSE or NEON by the host's target. Values of type `vec` mix with float32 scalars in
+, - and *; comparisons give a `mask` that `select` consumes.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, overload, register_model

from tdgbench.splats.cpu.jit import lanes

LANES = lanes()

FLOATS = ir.VectorType(ir.FloatType(), LANES)
BITS = ir.VectorType(ir.IntType(32), LANES)
_FLAGS = ir.VectorType(ir.IntType(1), LANES)
FAST = ("contract", "nsz", "nnan", "arcp")


class VectorType(types.Type):
    """A register of floats (`vec`) or of booleans (`mask`)."""

    def __init__(self, name: str, llvm_type: ir.VectorType) -> None:
        super().__init__(name=name)
        self.llvm_type = llvm_type


@register_model(VectorType)
class VectorModel(models.PrimitiveModel):
    def __init__(self, manager, vector_type):
        super().__init__(manager, vector_type, vector_type.llvm_type)


vec = VectorType("vec", FLOATS)
mask = VectorType("mask", _FLAGS)


def _is_operand(t: types.Type) -> bool:
    return t in (vec, types.float32)


def _broadcast(builder, scalar):
    empty = ir.Constant(FLOATS, ir.Undefined)
    first = builder.insert_element(empty, scalar, ir.IntType(32)(0))
    return builder.shuffle_vector(first, empty, ir.Constant(BITS, [0] * LANES))


def _as_vector(builder, value, value_type):
    return value if value_type == vec else _broadcast(builder, value)


def constant(value: float) -> ir.Constant:
    return ir.Constant(FLOATS, [ir.FloatType()(float(np.float32(value)))] * LANES)


def _arithmetic(instruction: str):
    @intrinsic
    def operation(typing_context, x, y):
        def generate(context, builder, signature, args):
            a, b = (_as_vector(builder, v, t) for v, t in zip(args, signature.args, strict=True))
            return getattr(builder, instruction)(a, b, flags=FAST)

        if _is_operand(x) and _is_operand(y):
            return vec(x, y), generate
        return None

    return operation


_add, _sub, _mul = _arithmetic("fadd"), _arithmetic("fsub"), _arithmetic("fmul")


def _overload_operator(python_operator, function) -> None:
    @overload(python_operator)
    def typed(x, y):
        if vec in (x, y) and _is_operand(x) and _is_operand(y):
            return lambda x, y: function(x, y)
        return None


for _operator, _function in (
    (operator.add, _add),
    (operator.sub, _sub),
    (operator.mul, _mul),
    (operator.iadd, _add),
    (operator.isub, _sub),
    (operator.imul, _mul),
):
    _overload_operator(_operator, _function)


@intrinsic
def _negate(typing_context, x):
    return vec(vec), lambda context, builder, signature, args: builder.fneg(args[0], flags=FAST)


@overload(operator.neg)
def _negative(x):
    return (lambda x: _negate(x)) if x == vec else None


def _comparison(predicate: str):
    @intrinsic
    def operation(typing_context, x, y):
        def generate(context, builder, signature, args):
            a, b = (_as_vector(builder, v, t) for v, t in zip(args, signature.args, strict=True))
            return builder.fcmp_ordered(predicate, a, b)

        return mask(x, y), generate

    return operation


greater_equal, greater, less_equal, equal = (_comparison(p) for p in (">=", ">", "<=", "=="))


def _extremum(predicate: str):
    @intrinsic
    def operation(typing_context, x, y):
        def generate(context, builder, signature, args):
            a, b = (_as_vector(builder, v, t) for v, t in zip(args, signature.args, strict=True))
            return builder.select(builder.fcmp_ordered(predicate, a, b, flags=("nnan", "nsz")), a, b)

        return vec(x, y), generate

    return operation


minimum, maximum = _extremum("<"), _extremum(">")


@intrinsic
def both(typing_context, x, y):
    """Logical and of two masks."""
    return mask(mask, mask), lambda context, builder, signature, args: builder.and_(*args)


def _exponent_test(predicate: str, documentation: str):
    """A test of the bits without the sign: float comparisons are compiled as if there were no NaN."""

    @intrinsic
    def operation(typing_context, x):
        def generate(context, builder, signature, args):
            bits = builder.and_(builder.bitcast(args[0], BITS), ir.Constant(BITS, [2**31 - 1] * LANES))
            return builder.icmp_unsigned(predicate, bits, ir.Constant(BITS, [0x7F800000] * LANES))

        return mask(vec), generate

    operation.__doc__ = documentation
    return operation


is_nan = _exponent_test(">", "Lanes that hold NaN.")
is_finite = _exponent_test("<", "Lanes that hold neither NaN nor an infinity.")


@intrinsic
def is_nonzero(typing_context, x):
    """Lanes that hold neither 0 nor −0; NaN is not zero."""

    def generate(context, builder, signature, args):
        bits = builder.and_(builder.bitcast(args[0], BITS), ir.Constant(BITS, [2**31 - 1] * LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(BITS, [0] * LANES))

    return mask(vec), generate


@intrinsic
def select(typing_context, condition, x, y):
    """Lane by lane: x where the condition holds, else y."""

    def generate(context, builder, signature, args):
        a = _as_vector(builder, args[1], signature.args[1])
        b = _as_vector(builder, args[2], signature.args[2])
        return builder.select(args[0], a, b)

    return vec(mask, x, y), generate


@intrinsic
def negative_abs(typing_context, x):
    """-|x|, by setting the sign bits (also of zero)."""

    def generate(context, builder, signature, args):
        bits = builder.or_(builder.bitcast(args[0], BITS), ir.Constant(BITS, [-(2**31)] * LANES))
        return builder.bitcast(bits, FLOATS)

    return vec(vec), generate


@intrinsic
def absolute(typing_context, x):
    """|x|, by clearing the sign bits."""

    def generate(context, builder, signature, args):
        bits = builder.and_(builder.bitcast(args[0], BITS), ir.Constant(BITS, [2**31 - 1] * LANES))
        return builder.bitcast(bits, FLOATS)

    return vec(vec), generate


@intrinsic
def broadcast(typing_context, x):
    """All lanes equal to a float32."""
    return vec(types.float32), lambda context, builder, signature, args: _broadcast(builder, args[0])


def _elementwise(name: str, documentation: str):
    @intrinsic
    def operation(typing_context, x):
        def generate(context, builder, signature, args):
            full = f"llvm.{name}.v{LANES}f32"
            module = builder.module
            function = module.globals.get(full) or ir.Function(module, ir.FunctionType(FLOATS, [FLOATS]), full)
            return builder.call(function, [args[0]])

        return vec(vec), generate

    operation.__doc__ = documentation
    return operation


square_root = _elementwise("sqrt", "√x, correctly rounded.")
round_up = _elementwise("ceil", "The least whole number ≥ x.")
round_down = _elementwise("floor", "The greatest whole number ≤ x.")


@intrinsic
def divide(typing_context, x, y):
    """x / y, correctly rounded."""

    def generate(context, builder, signature, args):
        a, b = (_as_vector(builder, v, t) for v, t in zip(args, signature.args, strict=True))
        return builder.fdiv(a, b)

    return vec(x, y), generate


@intrinsic
def reciprocal(typing_context, x):
    """1 / x, to a rounding error or two."""
    flags = ("arcp", "afn", "contract", "nnan", "nsz", "ninf", "reassoc")
    return vec(vec), lambda context, builder, signature, args: builder.fdiv(constant(1.0), args[0], flags=flags)
