import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.doubles import narrow, over, widen
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.registers import LANES
from tests.splats.cpu.simd.arrays import aligned


@kernel()
def small_difference(values, large, out):
    x = widen(load(values, 0))
    store(out, 0, narrow((x * 3.0 + large) * over(1.0, x) - over(large, x)))


def test_keeps_what_single_precision_loses():
    values, out = aligned(np.linspace(0.5, 2, LANES)), aligned(np.zeros(LANES))
    small_difference(values, 1e9, out)
    assert np.allclose(out, 3.0, rtol=1e-6)
