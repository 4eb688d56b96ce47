"""Memory access of SIMD values: registers, scattered rows, transposes, prefetch, and a shared work counter.

`index`, `row`, `k`, offsets and strides are integer scalars; the last two count floats. `rows` (n,) int32 and `k` name
the rows rows[k], rows[k + 1], … of LANES lanes. Arrays are 1-D float32 where nothing else is said.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.registers import BITS, FLOATS, LANES, call_llvm, vec

U = np.uint64
LINE = 16  # floats of a cache line
_INDEX, _LONG = ir.IntType(32), ir.IntType(64)
_POINTER = ir.IntType(8).as_pointer()
_REGISTER = 4 * LANES  # bytes


@kernel(inline=True, allocates=True)
def aligned_floats(count):
    """Array (at least `count`,) float32 of zeros that begins on a 64-byte boundary."""
    raw = np.zeros(count + 16, np.float32)
    return raw[((-raw.ctypes.data) & 63) >> 2 :]


def _data(context, builder, array_type, array):
    return context.make_array(array_type)(context, builder, array).data


def _address(context, builder, array_type, array, index, kind=FLOATS):
    return builder.bitcast(builder.gep(_data(context, builder, array_type, array), [index]), kind.as_pointer())


def _loading(alignment: int, documentation: str):
    @intrinsic
    def operation(typing_context, array, index):
        def generate(context, builder, signature, args):
            return builder.load(_address(context, builder, signature.args[0], args[0], args[1]), align=alignment)

        return vec(array, index), generate

    operation.__doc__ = documentation
    return operation


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


load = _loading(_REGISTER, "LANES floats from an array, at an offset aligned to the register.")
load_anywhere = _loading(4, "LANES floats from an array, at any offset.")
store = _storing(_REGISTER, "LANES floats into an array, at an offset aligned to the register.")
store_anywhere = _storing(4, "LANES floats into an array, at any offset.")


def _row_of_four(builder, data, index, stride, row: int):
    """The address of data[index + row · stride : … + 4]."""
    place = builder.add(index, builder.mul(stride, _LONG(row)))
    return builder.bitcast(builder.gep(data, [place]), ir.VectorType(ir.FloatType(), 4).as_pointer())


@intrinsic
def load_rows(typing_context, array, index, stride):
    """LANES floats in rows of four: array[index : index + 4], array[index + stride : index + stride + 4], …

    The array has any shape, without gaps; index and stride count its floats. So do the three operations below.
    """

    def generate(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        rows = [builder.load(_row_of_four(builder, data, *args[1:], row), align=4) for row in range(LANES // 4)]
        while len(rows) > 1:
            count = 2 * rows[0].type.count
            joined = ir.Constant(ir.VectorType(_INDEX, count), list(range(count)))
            rows = [builder.shuffle_vector(a, b, joined) for a, b in zip(rows[::2], rows[1::2], strict=True)]
        return rows[0]

    return vec(array, types.int64, types.int64), generate


@intrinsic
def store_rows(typing_context, array, index, stride, value):
    """Write LANES floats in rows of four, where `load_rows` reads them."""

    def generate(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        for row in range(LANES // 4):
            lanes = ir.Constant(ir.VectorType(_INDEX, 4), list(range(4 * row, 4 * row + 4)))
            four = builder.shuffle_vector(args[3], args[3], lanes)
            builder.store(four, _row_of_four(builder, data, args[1], args[2], row), align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, vec), generate


def _places(builder, index, stride, step):
    """Where each lane of `gather_rows` is."""
    for lane in range(LANES):
        row, column = divmod(lane, 4)
        yield lane, builder.add(builder.add(index, builder.mul(stride, _LONG(row))), builder.mul(step, _LONG(column)))


@intrinsic
def gather_rows(typing_context, array, index, stride, step):
    """LANES floats in rows of four, `step` apart: lane l is array[index + l // 4 · stride + l % 4 · step]."""

    def generate(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        result = ir.Constant(FLOATS, ir.Undefined)
        for lane, place in _places(builder, *args[1:]):
            result = builder.insert_element(result, builder.load(builder.gep(data, [place])), _INDEX(lane))
        return result

    return vec(array, types.int64, types.int64, types.int64), generate


@intrinsic
def scatter_rows(typing_context, array, index, stride, step, value):
    """Write LANES floats where `gather_rows` reads them."""

    def generate(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        for lane, place in _places(builder, *args[1:4]):
            builder.store(builder.extract_element(args[4], _INDEX(lane)), builder.gep(data, [place]))
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, types.int64, vec), generate


@kernel(inline=True)
def load_channel(image, pixel, width, channels, channel):
    """One channel of LANES pixels in rows of four, the first of them number `pixel` of an image, which has channels."""
    if channels == 1:
        return load_rows(image, pixel, width)
    return gather_rows(image, pixel * channels + channel, width * channels, channels)


@kernel(inline=True)
def store_channel(image, pixel, width, channels, channel, value):
    """Write what `load_channel` reads."""
    if channels == 1:
        store_rows(image, pixel, width, value)
    else:
        scatter_rows(image, pixel * channels + channel, width * channels, channels, value)


def _every_second(builder, a, b, first: int):
    """Lanes first, first + 2, … of two registers, one after the other."""
    index = ir.Constant(BITS, list(range(first, 2 * LANES, 2)))
    return builder.shuffle_vector(a, b, index)


@intrinsic
def load_fours(typing_context, array, index):
    """Four registers: the columns of LANES rows of four floats, from array[index] on."""

    def generate(context, builder, signature, args):
        starts = [builder.add(args[1], _LONG(i * LANES)) for i in range(4)]
        parts = [
            builder.load(_address(context, builder, signature.args[0], args[0], start), align=4) for start in starts
        ]
        halves = [[_every_second(builder, *parts[i : i + 2], first) for i in (0, 2)] for first in (0, 1)]
        columns = [_every_second(builder, *halves[c % 2], c // 2) for c in range(4)]
        return context.make_tuple(builder, signature.return_type, columns)

    return types.UniTuple(vec, 4)(array, types.int64), generate


@intrinsic
def store_whole(typing_context, array, index, value):
    """LANES whole numbers (a register of floats) into an int32 array, at any offset; others become anything."""

    def generate(context, builder, signature, args):
        target = _address(context, builder, signature.args[0], args[0], args[1], BITS)
        builder.store(builder.fptosi(args[2], BITS), target, align=4)
        return context.get_dummy_value()

    return types.void(array, index, vec), generate


@intrinsic
def prefetch(typing_context, values, index):
    """Prefetch the cache line of values[index], of any type."""

    def generate(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        _call_prefetch(builder, builder.bitcast(builder.gep(data, [args[1]]), _POINTER))
        return context.get_dummy_value()

    return types.void(values, index), generate


@intrinsic
def prefetch_row(typing_context, array, row):
    """Prefetch row `row` (unsigned) of a 2-D array."""

    def generate(context, builder, signature, args):
        struct = context.make_array(signature.args[0])(context, builder, args[0])
        stride = builder.extract_value(struct.strides, 0)
        address = builder.add(builder.ptrtoint(struct.data, _LONG), builder.mul(args[1], stride))
        _call_prefetch(builder, builder.inttoptr(address, _POINTER))
        return context.get_dummy_value()

    return types.void(array, row), generate


def _call_prefetch(builder, pointer):
    call_llvm(builder, "llvm.prefetch.p0", ir.VoidType(), pointer, _INDEX(0), _INDEX(3), _INDEX(1))


@kernel(inline=True)
def prefetch_columns(values, row, stride, column, count):
    """Prefetch columns [column, column + count) of a row of a matrix (rows, stride) in flat memory."""
    first = row * stride + column
    for j in range(0, count, LINE):
        prefetch(values, U(first + j))
    prefetch(values, U(first + count - 1))  # a row may begin within a cache line


def _element(builder, data, row, stride, column):
    """The address of data[row · stride + column]."""
    return builder.gep(data, [builder.add(builder.mul(row, stride), column)])


def _row(builder, index, k, lane: int):
    """rows[k + lane], given the data of `rows`."""
    return builder.sext(builder.load(builder.gep(index, [builder.add(k, _LONG(lane))])), _LONG)


@intrinsic
def gather(typing_context, values, rows, k, stride, column):
    """Lane l: values[rows[k + l] · stride + column]."""

    def generate(context, builder, signature, args):
        data, index = (_data(context, builder, signature.args[i], args[i]) for i in (0, 1))
        result = ir.Constant(FLOATS, ir.Undefined)
        for lane in range(LANES):
            place = _element(builder, data, _row(builder, index, args[2], lane), args[3], args[4])
            result = builder.insert_element(result, builder.load(place), _INDEX(lane))
        return result

    return vec(values, rows, types.int64, types.int64, types.int64), generate


@intrinsic
def put_column(typing_context, values, first_row, stride, column, value):
    """values[(first_row + l) · stride + column] = lane l."""

    def generate(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        for lane in range(LANES):
            place = _element(builder, data, builder.add(args[1], _LONG(lane)), args[2], args[3])
            builder.store(builder.extract_element(args[4], _INDEX(lane)), place)
        return context.get_dummy_value()

    return types.void(values, types.int64, types.int64, types.int64, vec), generate


def _transposed(builder, registers: list) -> list:
    """Registers of the columns of a square, by swapping blocks of half the size off its diagonal, then smaller ones."""
    step = LANES // 2
    while step >= 1:
        upper = ir.Constant(BITS, [lane if not lane & step else LANES + lane - step for lane in range(LANES)])
        lower = ir.Constant(BITS, [lane + step if not lane & step else LANES + lane for lane in range(LANES)])
        for i in range(LANES):
            if not i & step:
                a, b = registers[i], registers[i + step]
                registers[i] = builder.shuffle_vector(a, b, upper)
                registers[i + step] = builder.shuffle_vector(a, b, lower)
        step //= 2
    return registers


@intrinsic
def gather_block(typing_context, values, rows, k, stride, column, out, at):
    """out[at + c LANES + l] = values[rows[k + l] · stride + column + c] for c, l < LANES; `at` on register bounds."""

    def generate(context, builder, signature, args):
        index = _data(context, builder, signature.args[1], args[1])
        registers = []
        for lane in range(LANES):
            place = builder.add(builder.mul(_row(builder, index, args[2], lane), args[3]), args[4])
            registers.append(builder.load(_address(context, builder, signature.args[0], args[0], place), align=4))
        for c, register in enumerate(_transposed(builder, registers)):
            place = builder.add(args[6], _LONG(c * LANES))
            builder.store(register, _address(context, builder, signature.args[5], args[5], place), align=_REGISTER)
        return context.get_dummy_value()

    long = types.int64
    return types.void(values, rows, long, long, long, out, long), generate


@intrinsic
def turn_block(typing_context, block, at, step, out, first, stride):
    """out[first + l · stride + c] = block[at + c · step + l] for c, l < LANES, at any offset."""

    def generate(context, builder, signature, args):
        def address(argument, number):
            place = builder.add(args[argument + 1], builder.mul(_LONG(number), args[argument + 2]))
            return _address(context, builder, signature.args[argument], args[argument], place)

        registers = [builder.load(address(0, c), align=4) for c in range(LANES)]
        for lane, register in enumerate(_transposed(builder, registers)):
            builder.store(register, address(3, lane), align=4)
        return context.get_dummy_value()

    long = types.int64
    return types.void(block, long, long, out, long, long), generate


@intrinsic
def take_next(typing_context, counter):
    """Atomically counter[0]++, counter (1,) int64; returns the old value: hands out work to threads without the GIL."""

    def generate(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        return builder.atomic_rmw("add", data, _LONG(1), "monotonic")

    return types.int64(counter), generate


@intrinsic
def float_bits(typing_context, x):
    """The bits of a float32 as int32; for positive floats their order is the order of the numbers."""
    return types.int32(types.float32), lambda context, builder, signature, args: builder.bitcast(args[0], _INDEX)
