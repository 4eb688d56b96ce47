"""The SIMD type, operation by operation, against numpy: lane by lane, reductions, powers."""

import numpy as np
import pytest

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd import memory, powers, reductions
from tdgbench.splats.cpu.simd import registers as simd
from tdgbench.splats.cpu.simd.registers import LANES

F = np.float32


def aligned(values) -> np.ndarray:
    """An array that whole registers can be loaded from."""
    out = empty_aligned((len(values),), np.float32)
    out[:] = values
    return out


@kernel()
def arithmetic(a, b, s, out):
    x, y = memory.load(a, 0), memory.load(b, 0)
    memory.store(out, 0 * LANES, x + y)
    memory.store(out, 1 * LANES, x - s)
    memory.store(out, 2 * LANES, s * y)
    memory.store(out, 3 * LANES, simd.minimum(x, y))
    memory.store(out, 4 * LANES, simd.maximum(x, s))
    memory.store(out, 5 * LANES, simd.select(simd.greater(x, y), x, s))
    memory.store(out, 6 * LANES, simd.select(simd.both(simd.greater_equal(x, y), simd.less_equal(x, s)), x, y))
    memory.store(out, 7 * LANES, simd.negative_abs(x))
    memory.store(out, 8 * LANES, simd.absolute(x))
    memory.store(out, 9 * LANES, simd.reciprocal(y))
    memory.store(out, 10 * LANES, simd.divide(x, y))
    memory.store(out, 11 * LANES, simd.square_root(simd.absolute(x)))
    memory.store(out, 12 * LANES, simd.round_up(x * s))
    memory.store(out, 13 * LANES, simd.round_down(x * s))
    memory.store(out, 14 * LANES, -x)
    memory.store(out, 15 * LANES, simd.select(simd.equal(x, y), y, s))


def test_lane_by_lane():
    rng = np.random.default_rng(0)
    a, b = aligned(4 * rng.normal(size=LANES).astype(F)), aligned(rng.normal(size=LANES).astype(F))
    a[0] = b[0]
    s, out = F(0.3), aligned(np.zeros(16 * LANES, F))
    arithmetic(a, b, s, out)
    expected = [
        a + b, a - s, s * b, np.minimum(a, b), np.maximum(a, s), np.where(a > b, a, s),
        np.where((a >= b) & (a <= s), a, b), -np.abs(a), np.abs(a), 1 / b, a / b,
        np.sqrt(np.abs(a)), np.ceil(a * s), np.floor(a * s), -a, np.where(a == b, b, s),
    ]  # fmt: skip
    for row, want in zip(out.reshape(16, LANES), expected, strict=True):
        assert np.allclose(row, want, rtol=1e-6, atol=0)


@kernel()
def zeros_sign(out):
    memory.store(out, 0, simd.negative_abs(simd.broadcast(F(0.0))))


def test_the_sign_of_zero_is_set():
    out = aligned(np.ones(LANES, F))
    zeros_sign(out)
    assert (out == 0).all() and np.signbit(out).all()


@kernel()
def nonzero(a, out):
    memory.store(out, 0, simd.select(simd.is_nonzero(memory.load(a, 0)), F(1), F(0)))


def test_nothing_but_zeros_is_zero():
    a, out = aligned(np.zeros(LANES, F)), aligned(np.full(LANES, 7, F))
    a[1:6] = [-0.0, np.nan, 1e-45, -np.inf, 2.0]
    nonzero(a, out)
    assert out[:6].tolist() == [0, 0, 1, 1, 1, 1] and not out[6:].any()


@kernel()
def small_difference(values, large, out):
    x = simd.widen(memory.load(values, 0))
    memory.store(out, 0, simd.narrow((x * 3.0 + large) * simd.divide_doubles(1.0, x) - simd.divide_doubles(large, x)))


def test_doubles_keep_what_single_precision_loses():
    values, out = aligned(np.linspace(0.5, 2, LANES)), aligned(np.zeros(LANES))
    small_difference(values, 1e9, out)
    assert np.allclose(out, 3.0, rtol=1e-6)


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


@kernel()
def powers_of(values, table, by_table, by_constants, logarithms):
    for i in range(0, values.shape[0], LANES):
        x = memory.load(values, i)
        memory.store(by_table, i, powers.exp2_in_memory(x, table))
        memory.store(by_constants, i, powers.exp2(x))
        memory.store(logarithms, i, powers.log2(x))


def powers_and_logarithms(given) -> tuple[np.ndarray, ...]:
    """The values, as float64, their powers of two by either function, and their logarithms."""
    values, *out = (aligned(given.astype(F)) for _ in range(4))
    powers_of(values, powers.COEFFICIENTS, *out)
    return values.astype(np.float64), *out


def test_powers_of_two():
    values, *found, _ = powers_and_logarithms(np.linspace(-125, 125, 4096 * LANES))
    for out in found:
        assert 0 < np.abs(out / np.exp2(values) - 1).max() < 2.5e-7


def test_log2():
    near_one, wide = np.linspace(0.5, 2, 1024 * LANES), np.exp2(np.linspace(-120, 120, 1024 * LANES))
    for given, relative, absolute in ((near_one, 0, 1e-7), (wide, 2e-7, 2e-7)):
        values, _, _, logarithms = powers_and_logarithms(given)
        assert np.allclose(logarithms, np.log2(values), rtol=relative, atol=absolute)
