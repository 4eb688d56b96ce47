"""An explicit SIMD type for Numba: one value is a whole register of LANES floats (`vec`), doubles or booleans (`mask`).

Numba's auto-vectoriser is fragile (a harmless edit can cost a factor of six); an LLVM vector type is not. The same
source becomes AVX-512, AVX2, SSE or NEON by the host's target. `vec` mixes with float32 scalars and `doubles` with
float64 ones in +, - and *; comparisons of `vec` give a `mask`, which `select` consumes.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, overload, register_model

from tdgbench.splats.cpu.jit import lanes

LANES = lanes()

FLOATS = ir.VectorType(ir.FloatType(), LANES)
DOUBLES = ir.VectorType(ir.DoubleType(), LANES)
BITS = ir.VectorType(ir.IntType(32), LANES)
_FLAGS = ir.VectorType(ir.IntType(1), LANES)
FAST = ("contract", "nsz", "nnan", "arcp")
WITHOUT_SIGN, SIGN, INFINITY = 2**31 - 1, -(2**31), 0x7F800000  # bits of a float


class VectorType(types.Type):
    """A register of floats (`vec`), of doubles, or of booleans (`mask`)."""

    def __init__(self, name: str, llvm_type: ir.VectorType) -> None:
        super().__init__(name=name)
        self.llvm_type = llvm_type


@register_model(VectorType)
class VectorModel(models.PrimitiveModel):
    def __init__(self, manager, vector_type):
        super().__init__(manager, vector_type, vector_type.llvm_type)


vec = VectorType("vec", FLOATS)
doubles = VectorType("doubles", DOUBLES)
mask = VectorType("mask", _FLAGS)


def constant(value: float) -> ir.Constant:
    return ir.Constant(FLOATS, [ir.FloatType()(float(np.float32(value)))] * LANES)


def bits(value: int) -> ir.Constant:
    return ir.Constant(BITS, [value] * LANES)


def _broadcast(builder, scalar):
    empty = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
    first = builder.insert_element(empty, scalar, ir.IntType(32)(0))
    return builder.shuffle_vector(first, empty, bits(0))


def on_registers(result: types.Type, emit: Callable, documentation: str = ""):
    """Make an operation of registers and scalars, which are repeated in all lanes: emit(builder, a register, …)."""

    def operation(typing_context, *operands):
        def generate(context, builder, signature, args):
            given = zip(args, signature.args, strict=True)
            return emit(builder, *(v if isinstance(t, VectorType) else _broadcast(builder, v) for v, t in given))

        return result(*operands), generate

    operation.__doc__ = documentation
    operation.__signature__ = inspect.signature(emit)  # Numba takes no variable number of arguments
    return intrinsic(operation)


@intrinsic
def broadcast(typing_context, x):
    """All lanes equal to a float32."""
    return vec(types.float32), lambda context, builder, signature, args: _broadcast(builder, args[0])


def _overload_operator(name: str, kind: VectorType, scalar: types.Type, operation) -> None:
    @overload(getattr(operator, name))
    def typed(x, y):
        if kind in (x, y) and {x, y} <= {kind, scalar}:
            return lambda x, y: operation(x, y)
        return None


def _arithmetic(kind: VectorType, instruction: str):
    return on_registers(kind, lambda builder, a, b: getattr(builder, instruction)(a, b, flags=FAST))


for _kind, _scalar in ((vec, types.float32), (doubles, types.float64)):
    for _name in ("add", "sub", "mul"):
        _operation = _arithmetic(_kind, f"f{_name}")
        for _operator in (_name, f"i{_name}"):
            _overload_operator(_operator, _kind, _scalar, _operation)

_negate = on_registers(vec, lambda builder, x: builder.fneg(x, flags=FAST))


@overload(operator.neg)
def _negative(x):
    return (lambda x: _negate(x)) if x == vec else None


def _comparison(predicate: str):
    return on_registers(mask, lambda builder, a, b: builder.fcmp_ordered(predicate, a, b))


def _extremum(predicate: str):
    flags = ("nnan", "nsz")
    return on_registers(
        vec, lambda builder, a, b: builder.select(builder.fcmp_ordered(predicate, a, b, flags=flags), a, b)
    )


def _bits_test(predicate: str, value: int, documentation: str):
    """Return a test of the bits without the sign: float comparisons are compiled as if there were no NaN."""

    def emit(builder, x):
        unsigned = builder.and_(builder.bitcast(x, BITS), bits(WITHOUT_SIGN))
        return builder.icmp_unsigned(predicate, unsigned, bits(value))

    return on_registers(mask, emit, documentation)


greater_equal, greater, less_equal, equal = (_comparison(predicate) for predicate in (">=", ">", "<=", "=="))
minimum, maximum = _extremum("<"), _extremum(">")
is_nan = _bits_test(">", INFINITY, "Lanes that hold NaN.")
is_finite = _bits_test("<", INFINITY, "Lanes that hold neither NaN nor an infinity.")
is_nonzero = _bits_test("!=", 0, "Lanes that hold neither 0 nor −0; NaN is not zero.")
both = on_registers(mask, lambda builder, a, b: builder.and_(a, b), "Logical and of two masks.")
select = on_registers(
    vec, lambda builder, condition, a, b: builder.select(condition, a, b), "Lane by lane: a where the mask holds, or b."
)
negative_abs = on_registers(
    vec,
    lambda builder, x: builder.bitcast(builder.or_(builder.bitcast(x, BITS), bits(SIGN)), FLOATS),
    "-|x|, by setting the sign bits (also of zero).",
)
absolute = on_registers(
    vec,
    lambda builder, x: builder.bitcast(builder.and_(builder.bitcast(x, BITS), bits(WITHOUT_SIGN)), FLOATS),
    "|x|, by clearing the sign bits.",
)


def _elementwise(name: str, documentation: str):
    def emit(builder, x):
        full = f"llvm.{name}.v{LANES}f32"
        known = builder.module.globals.get(full)
        return builder.call(known or ir.Function(builder.module, ir.FunctionType(FLOATS, [FLOATS]), full), [x])

    return on_registers(vec, emit, documentation)


square_root = _elementwise("sqrt", "√x, correctly rounded.")
round_up = _elementwise("ceil", "The least whole number ≥ x.")
round_down = _elementwise("floor", "The greatest whole number ≤ x.")
divide = on_registers(vec, lambda builder, x, y: builder.fdiv(x, y), "x / y, correctly rounded.")
divide_doubles = on_registers(doubles, lambda builder, x, y: builder.fdiv(x, y), "x / y of doubles, correctly rounded.")
reciprocal = on_registers(
    vec,
    lambda builder, x: builder.fdiv(
        constant(1.0), x, flags=("arcp", "afn", "contract", "nnan", "nsz", "ninf", "reassoc")
    ),
    "1 / x, to a rounding error or two.",
)
widen = on_registers(doubles, lambda builder, x: builder.fpext(x, DOUBLES), "The floats of a register as doubles.")
narrow = on_registers(vec, lambda builder, x: builder.fptrunc(x, FLOATS), "Doubles rounded to floats.")
