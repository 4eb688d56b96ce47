"""The SIMD type, operation by operation, against numpy."""

import numpy as np
import pytest

from tdgbench.splats.cpu import simd
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd import LANES

F = np.float32


def aligned(values) -> np.ndarray:
    raw = np.zeros(len(values) + 32, F)
    start = (-raw.ctypes.data % 64) // 4
    raw[start : start + len(values)] = values
    return raw[start : start + len(values)]


@kernel()
def arithmetic(a, b, s, out):
    x, y = simd.load(a, 0), simd.load(b, 0)
    simd.store(out, 0 * LANES, x + y)
    simd.store(out, 1 * LANES, x - s)
    simd.store(out, 2 * LANES, s * y)
    simd.store(out, 3 * LANES, simd.minimum(x, y))
    simd.store(out, 4 * LANES, simd.maximum(x, s))
    simd.store(out, 5 * LANES, simd.select(simd.greater(x, y), x, s))
    simd.store(out, 6 * LANES, simd.select(simd.both(simd.greater_equal(x, y), simd.less_equal(x, s)), x, y))
    simd.store(out, 7 * LANES, simd.negative_abs(x))
    simd.store(out, 8 * LANES, simd.absolute(x))
    simd.store(out, 9 * LANES, simd.reciprocal(y))
    simd.store(out, 10 * LANES, simd.lane_index() + simd.splat(s))


def test_lane_by_lane():
    rng = np.random.default_rng(0)
    a, b = aligned(rng.normal(size=LANES).astype(F)), aligned(rng.normal(size=LANES).astype(F))
    a[0] = b[0]
    s, out = F(0.3), aligned(np.zeros(11 * LANES, F))
    arithmetic(a, b, s, out)
    expected = [
        a + b, a - s, s * b, np.minimum(a, b), np.maximum(a, s), np.where(a > b, a, s),
        np.where((a >= b) & (a <= s), a, b), -np.abs(a), np.abs(a), 1 / b, np.arange(LANES) + s,
    ]  # fmt: skip
    for row, want in zip(out.reshape(11, LANES), expected, strict=True):
        assert np.allclose(row, want, rtol=1e-6, atol=0)


@kernel()
def zeros_sign(out):
    simd.store(out, 0, simd.negative_abs(simd.splat(F(0.0))))


def test_the_sign_of_zero_is_set():
    out = aligned(np.ones(LANES, F))
    zeros_sign(out)
    assert (out == 0).all() and np.signbit(out).all()


@kernel()
def exponential(values, out):
    for i in range(0, values.shape[0], LANES):
        simd.store(out, i, simd.exp2(simd.load(values, i)))


def test_exp2():
    values = aligned(np.linspace(-125, 125, 4096 * LANES).astype(F))
    out = aligned(np.zeros(len(values), F))
    exponential(values, out)
    exact = np.exp2(values.astype(np.float64))
    assert np.abs(out / exact - 1).max() < 2.5e-7


@kernel()
def sums(values, one, eight):
    v = simd.load(values, 0)
    one[0] = simd.lane_sum(v)
    k = F(2)
    simd.store(eight, 0, simd.lane_sums_of_8(v, v * k, v - k, v * v, k * k * v, v, v + v, simd.splat(k)))


def test_sums_over_lanes():
    v = aligned(np.random.default_rng(1).normal(size=LANES).astype(F))
    one, eight = np.zeros(1, F), aligned(np.zeros(max(LANES, 8), F))
    sums(v, one, eight)
    want = [x.sum() for x in (v, 2 * v, v - 2, v * v, 4 * v, v, 2 * v, np.full(LANES, 2.0))]
    assert one[0] == pytest.approx(want[0], rel=1e-5, abs=1e-5)
    assert np.allclose(eight[:8], want, rtol=1e-5, atol=1e-5)


@kernel()
def questions(values, out):
    out[0] = simd.any_positive(simd.load(values, 0))
    out[1] = simd.float_bits(values[0])


def test_any_positive_and_bits():
    out = np.zeros(2, np.int64)
    values = aligned(np.full(LANES, -1, F))
    questions(values, out)
    assert out[0] == 0 and np.int32(out[1]) == np.float32(-1).view(np.int32)
    values[LANES - 1] = 1e-30
    questions(values, out)
    assert out[0] == 1


@kernel()
def take(counter, out):
    for i in range(out.shape[0]):
        out[i] = simd.take_next(counter)


def test_work_is_handed_out_once():
    from tdgbench.splats.cpu import pool

    counter = np.zeros(1, np.int64)
    taken = [np.zeros(10_000, np.int64) for _ in range(3)]
    pool.run(take, [(counter, out) for out in taken])
    assert np.array_equal(np.sort(np.concatenate(taken)), np.arange(30_000))
