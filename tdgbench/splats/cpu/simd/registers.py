"""An explicit SIMD type for Numba: one value is a whole register of LANES floats (`vec`), doubles or booleans (`mask`).

Numba's auto-vectoriser is fragile (a harmless edit can cost a factor of six); an LLVM vector type is not. The same
source becomes AVX-512, AVX2, SSE or NEON by the host's target. `vec` mixes with float32 scalars and `doubles` with
float64 ones in +, - and *; comparisons of `vec` give a `mask`, which `select` consumes. Sums over lanes have a fixed
order.
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
_INDEX = ir.IntType(32)
FAST = ("contract", "nsz", "nnan", "arcp")
WITHOUT_SIGN, SIGN, INFINITY = 2**31 - 1, -(2**31), 0x7F800000  # bits of a float
# 2^x = 2^n 2^r, r in [-1/2, 1/2]: minimax polynomial of 2^r to 2.5e-7 relative, from the highest power down.
EXP2 = (0.00132764718, 0.00967554133, 0.0555071327, 0.240221197, 0.693146967, 1.00000007)
ROOT_HALF = 0x3F3504F3  # the bits of √½


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


def call_llvm(builder, name: str, result: ir.Type, *operands):
    """Call an intrinsic function of LLVM."""
    signature = ir.FunctionType(result, [operand.type for operand in operands])
    known = builder.module.globals.get(name)
    return builder.call(known or ir.Function(builder.module, signature, name), operands)


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
    full_name = f"llvm.{name}.v{LANES}f32"
    return on_registers(vec, lambda builder, x: call_llvm(builder, full_name, FLOATS, x), documentation)


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
exp2_by = on_registers(
    vec,
    lambda builder, x, a, b, c, d, e, f: _power_of_two(builder, x, (a, b, c, d, e, f)),
    "As `exp2`, with its coefficients as operands: the compiler broadcasts a constant at every use.",
)


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


@intrinsic
def lowest(typing_context, number):
    """Number of the lowest bit of a number above zero."""

    def generate(context, builder, signature, args):
        return call_llvm(builder, "llvm.cttz.i64", ir.IntType(64), args[0], ir.IntType(1)(1))

    return types.uint64(types.uint64), generate
