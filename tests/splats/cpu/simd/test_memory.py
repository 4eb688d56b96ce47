import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd import memory
from tdgbench.splats.cpu.simd.registers import LANES

F = np.float32


@kernel()
def move(values, rows, k, out, columns):
    """Column by column from scattered rows of `values` to consecutive rows of `out`."""
    for column in range(columns):
        memory.put_column(out, 2, columns, column, memory.gather(values, rows, k, columns, column))


def test_columns_of_scattered_rows():
    rng = np.random.default_rng(0)
    values, rows = rng.normal(size=(50, 3)).astype(F), rng.integers(0, 50, LANES + 5).astype(np.int32)
    out = np.zeros((LANES + 4, 3), F)
    move(values.reshape(-1), rows, 4, out.reshape(-1), 3)
    assert np.array_equal(out[2 : 2 + LANES], values[rows[4 : 4 + LANES]])
    assert not out[:2].any() and not out[2 + LANES :].any()


@kernel()
def copy(values, out):
    memory.prefetch(values, np.uint64(0))
    for i in range(0, values.shape[0], LANES):
        memory.store(out, i, memory.load(values, i))


def test_whole_registers():
    values, out = empty_aligned((4 * LANES,), F), empty_aligned((4 * LANES,), F)
    values[:] = np.random.default_rng(1).normal(size=4 * LANES)
    copy(values, out)
    assert np.array_equal(values, out)


@kernel()
def bits(values, out):
    memory.prefetch_row(values, np.uint64(0))
    for i in range(out.shape[0]):
        out[i] = memory.float_bits(values[i, 0])


def test_float_bits_keep_the_order_of_positive_numbers():
    values = np.sort(np.random.default_rng(2).exponential(size=(30, 1)).astype(F), axis=0)
    out = np.zeros(30, np.int32)
    bits(values, out)
    assert np.array_equal(out, values[:, 0].view(np.int32)) and (np.diff(out) > 0).all()


@kernel()
def start_of(count):
    array = memory.aligned_floats(count)
    array[0] = F(1)
    return array.ctypes.data, array.sum()


def test_room_begins_on_a_cache_line():
    for count in (1, 16, 100):
        address, total = start_of(count)
        assert address % 64 == 0 and total == 1.0


@kernel()
def take(counter, out):
    for i in range(out.shape[0]):
        out[i] = memory.take_next(counter)


def test_work_is_handed_out_once():
    counter = np.zeros(1, np.int64)
    taken = [np.zeros(10_000, np.int64) for _ in range(3)]
    pool.run(take, [(counter, out) for out in taken])
    assert np.array_equal(np.sort(np.concatenate(taken)), np.arange(30_000))


@kernel()
def fours(values, index, out):
    for c, register in enumerate(memory.load_fours(values, index)):
        memory.store(out, c * LANES, register)


def test_columns_of_rows_of_four():
    values, out = np.arange(6 * LANES, dtype=F), empty_aligned((4 * LANES,), F)
    fours(values, 5, out)
    assert np.array_equal(out.reshape(4, LANES), values[5 : 5 + 4 * LANES].reshape(LANES, 4).T)


@kernel()
def whole(values, out):
    memory.store_whole(out, 3, memory.load(values, 0))


def test_whole_numbers():
    values, out = empty_aligned((LANES,), F), np.zeros(LANES + 4, np.int32)
    values[:] = np.arange(LANES) - 4
    whole(values, out)
    assert np.array_equal(out[3 : 3 + LANES], np.arange(LANES) - 4) and out[:3].tolist() == [0, 0, 0] and out[-1] == 0


@kernel()
def gather_all(values, rows, k, stride, column, out, at):
    memory.gather_block(values, rows, k, stride, column, out, at)


def test_rows_become_columns():
    rng = np.random.default_rng(0)
    values, rows = rng.normal(size=(50, 2 * LANES + 3)).astype(F), rng.integers(0, 50, LANES + 5).astype(np.int32)
    out = empty_aligned(((LANES + 2) * LANES,), F)
    out[:] = 7
    gather_all(values.reshape(-1), rows, 4, values.shape[1], 3, out, LANES)
    found = out.reshape(-1, LANES)
    assert np.array_equal(found[1 : 1 + LANES], values[rows[4 : 4 + LANES], 3 : 3 + LANES].T)
    assert (found[0] == 7).all() and (found[1 + LANES :] == 7).all()


@kernel()
def turn(block, at, step, out, first, stride):
    memory.turn_block(block, at, step, out, first, stride)


def test_columns_become_rows():
    block = np.random.default_rng(1).normal(size=(LANES, LANES + 2)).astype(F)
    out = np.zeros((LANES + 1, LANES + 5), F)
    turn(block.reshape(-1), 1, LANES + 2, out.reshape(-1), LANES + 5 + 2, LANES + 5)
    assert np.array_equal(out[1:, 2 : 2 + LANES], block[:, 1 : 1 + LANES].T)
    assert not out[0].any() and not out[:, :2].any() and not out[:, 2 + LANES :].any()
