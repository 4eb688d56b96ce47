import numpy as np
import pytest

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd import memory, reductions
from tdgbench.splats.cpu.simd import registers as simd
from tdgbench.splats.cpu.simd.registers import LANES
from tests.splats.cpu.simd.arrays import aligned

F = np.float32


@kernel()
def sums(values, one, four, eight):
    v = memory.load(values, 0)
    one[0] = reductions.lane_sum(v)
    k = F(2)
    memory.store(four, 0, reductions.lane_sums_of_4(v, v * k, v - k, v * v))
    memory.store(eight, 0, reductions.lane_sums_of_8(v, v * k, v - k, v * v, k * k * v, v, v + v, simd.broadcast(k)))


def test_sums_over_lanes():
    v = aligned(np.random.default_rng(1).normal(size=LANES).astype(F))
    one, four, eight = np.zeros(1, F), aligned(np.zeros(LANES, F)), aligned(np.zeros(LANES, F))
    sums(v, one, four, eight)
    want = [x.sum() for x in (v, 2 * v, v - 2, v * v, 4 * v, v, 2 * v, np.full(LANES, 2.0))]
    assert one[0] == pytest.approx(want[0], rel=1e-5, abs=1e-5)
    assert np.allclose(four[:4], want[:4], rtol=1e-5, atol=1e-5)
    assert np.allclose(eight[:8], want, rtol=1e-5, atol=1e-5)


@kernel()
def questions(values, out):
    v = memory.load(values, 0)
    out[0] = reductions.any_positive(v)
    out[1] = reductions.any_bit(v)
    out[2] = reductions.lane_bits(simd.greater(v, simd.broadcast(F(0))))


def asked(values) -> list[int]:
    out = np.zeros(3, np.int64)
    questions(aligned(np.array(values, F)), out)
    return out.tolist()


def test_questions_to_all_lanes():
    assert asked([0] * LANES) == [False, False, 0]
    assert asked([-1] * LANES) == [False, True, 0]
    assert asked([0] * (LANES - 1) + [-0.0]) == [False, True, 0]
    assert asked([-1] * (LANES - 1) + [1e-30]) == [True, True, 1 << (LANES - 1)]
    assert asked([1, -1] * (LANES // 2)) == [True, True, sum(1 << lane for lane in range(0, LANES, 2))]
