import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.registers import LANES
from tdgbench.splats.cpu.simd.transpose import gather_block, turn_block

F = np.float32


@kernel()
def gather_all(values, rows, k, stride, column, out, at):
    gather_block(values, rows, k, stride, column, out, at)


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
    turn_block(block, at, step, out, first, stride)


def test_columns_become_rows():
    block = np.random.default_rng(1).normal(size=(LANES, LANES + 2)).astype(F)
    out = np.zeros((LANES + 1, LANES + 5), F)
    turn(block.reshape(-1), 1, LANES + 2, out.reshape(-1), LANES + 5 + 2, LANES + 5)
    assert np.array_equal(out[1:, 2 : 2 + LANES], block[:, 1 : 1 + LANES].T)
    assert not out[0].any() and not out[:, :2].any() and not out[:, 2 + LANES :].any()
