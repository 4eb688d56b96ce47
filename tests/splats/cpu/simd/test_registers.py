"""The SIMD type, operation by operation, against numpy."""

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd import memory
from tdgbench.splats.cpu.simd import registers as simd
from tdgbench.splats.cpu.simd.registers import LANES
from tests.splats.cpu.simd.arrays import aligned

F = np.float32


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
