"""Memory access of SIMD values: whole registers, columns of scattered rows, prefetch, and a shared work counter.

`index`, `row` and `k` are integer scalars. Offsets count floats.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.registers import BITS, FLOATS, LANES, vec

U = np.uint64
LINE = 16  # floats of a cache line
_INDEX = ir.IntType(32)
_LONG = ir.IntType(64)


@kernel(inline=True, allocates=True)
def aligned_floats(count):
    """Array (at least `count`,) float32 of zeros that begins on a 64-byte boundary."""
    raw = np.zeros(count + 16, np.float32)
    return raw[((-raw.ctypes.data) & 63) >> 2 :]


def _address(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), FLOATS.as_pointer())


def _loading(alignment: int, documentation: str):
    @intrinsic
    def operation(typing_context, array, index):
        def generate(context, builder, signature, args):
            return builder.load(_address(context, builder, signature.args[0], args[0], args[1]), align=alignment)

        return vec(array, index), generate

    operation.__doc__ = documentation
    return operation


load = _loading(4 * LANES, "LANES floats from a 1-D float32 array, at an offset aligned to the register.")
load_anywhere = _loading(4, "LANES floats from a 1-D float32 array, at any offset.")


def _storing(alignment: int, documentation: str):
    @intrinsic
    def operation(typing_context, array, index, value):
        def generate(context, builder, signature, args):
            target = _address(context, builder, signature.args[0], args[0], args[1])
            builder.store(args[2], target, align=alignment)
            return context.get_dummy_value()

        return types.void(array, index, vec), generate

    operation.__doc__ = documentation
    return operation


def _every_second(builder, a, b, first: int):
    """Lanes first, first + 2, … of two registers, one after the other."""
    index = ir.Constant(ir.VectorType(_INDEX, LANES), list(range(first, 2 * LANES, 2)))
    return builder.shuffle_vector(a, b, index)


@intrinsic
def load_fours(typing_context, array, index):
    """Four registers: the columns of LANES rows of four floats, from array[index] on; array is 1-D float32."""

    def generate(context, builder, signature, args):
        parts = [
            builder.load(
                _address(context, builder, signature.args[0], args[0], builder.add(args[1], _LONG(i * LANES))), align=4
            )
            for i in range(4)
        ]
        halves = [[_every_second(builder, *parts[i : i + 2], first) for i in (0, 2)] for first in (0, 1)]
        columns = [_every_second(builder, *halves[c % 2], c // 2) for c in range(4)]
        return context.make_tuple(builder, signature.return_type, columns)

    return types.UniTuple(vec, 4)(array, types.int64), generate


@intrinsic
def store_whole(typing_context, array, index, value):
    """LANES whole numbers (a register of floats) into a 1-D int32 array, at any offset; others become anything."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        target = builder.bitcast(builder.gep(data, [args[1]]), BITS.as_pointer())
        builder.store(builder.fptosi(args[2], BITS), target, align=4)
        return context.get_dummy_value()

    return types.void(array, index, vec), generate


store = _storing(4 * LANES, "LANES floats into a 1-D float32 array, at an offset aligned to the register.")
store_anywhere = _storing(4, "LANES floats into a 1-D float32 array, at any offset.")


@intrinsic
def prefetch(typing_context, values, index):
    """Prefetch the cache line of values[index]; values is 1-D, any type."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        _call_prefetch(builder, builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer()))
        return context.get_dummy_value()

    return types.void(values, index), generate


def _call_prefetch(builder, pointer):
    name = "llvm.prefetch.p0"
    signature = ir.FunctionType(ir.VoidType(), [ir.IntType(8).as_pointer(), _INDEX, _INDEX, _INDEX])
    function = builder.module.globals.get(name) or ir.Function(builder.module, signature, name)
    builder.call(function, [pointer, _INDEX(0), _INDEX(3), _INDEX(1)])


@kernel(inline=True)
def prefetch_columns(values, row, stride, column, count):
    """Prefetch columns [column, column + count) of a row of a matrix (rows, stride) in flat float32 memory."""
    for j in range(0, count, LINE):
        prefetch(values, U(row * stride + column + j))


def _element(builder, data, row, stride, column):
    """The address of data[row · stride + column]."""
    return builder.gep(data, [builder.add(builder.mul(row, stride), column)])


@intrinsic
def gather(typing_context, values, rows, k, stride, column):
    """Lane l: values[rows[k + l] · stride + column]; values float32 and rows int32, both 1-D."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        index = context.make_array(signature.args[1])(context, builder, args[1]).data
        result = ir.Constant(FLOATS, ir.Undefined)
        for lane in range(LANES):
            row = builder.load(builder.gep(index, [builder.add(args[2], _LONG(lane))]))
            place = _element(builder, data, builder.sext(row, _LONG), args[3], args[4])
            result = builder.insert_element(result, builder.load(place), _INDEX(lane))
        return result

    return vec(values, rows, types.int64, types.int64, types.int64), generate


@kernel(inline=True)
def gather_3(values, rows, k, stride, column):
    """Three registers: columns column, + 1, + 2 of the rows rows[k …], as `gather`."""
    return (
        gather(values, rows, k, stride, column),
        gather(values, rows, k, stride, column + 1),
        gather(values, rows, k, stride, column + 2),
    )


@intrinsic
def put_column(typing_context, values, first_row, stride, column, value):
    """values[(first_row + l) · stride + column] = lane l; values is float32, contiguous."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        for lane in range(LANES):
            row = builder.add(args[1], _LONG(lane))
            place = _element(builder, data, row, args[2], args[3])
            builder.store(builder.extract_element(args[4], _INDEX(lane)), place)
        return context.get_dummy_value()

    return types.void(values, types.int64, types.int64, types.int64, vec), generate


@intrinsic
def take_next(typing_context, counter):
    """Atomically counter[0]++, counter (1,) int64; returns the old value: hands out work to threads without the GIL."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", data, ir.IntType(64)(1), "monotonic")

    return types.int64(counter), generate


@intrinsic
def float_bits(typing_context, x):
    """The bits of a float32 as int32; for positive floats their order is the order of the numbers."""
    return types.int32(types.float32), lambda context, builder, signature, args: builder.bitcast(
        args[0], ir.IntType(32)
    )


@intrinsic
def prefetch_row(typing_context, array, row):
    """Prefetch row `row` (unsigned) of a 2-D array."""

    def generate(context, builder, signature, args):
        struct = context.make_array(signature.args[0])(context, builder, args[0])
        stride = builder.extract_value(struct.strides, 0)
        address = builder.add(builder.ptrtoint(struct.data, ir.IntType(64)), builder.mul(args[1], stride))
        pointer = builder.inttoptr(address, ir.IntType(8).as_pointer())
        _call_prefetch(builder, pointer)
        return context.get_dummy_value()

    return types.void(array, row), generate
