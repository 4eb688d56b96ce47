"""Powers and logarithms of registers against numpy."""

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.alphas import exp2_in_memory
from tdgbench.splats.cpu.raster.blocks import TABLES
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd import memory
from tdgbench.splats.cpu.simd import registers as simd
from tdgbench.splats.cpu.simd.registers import LANES

F = np.float32


def aligned(values) -> np.ndarray:
    """An array that whole registers can be loaded from."""
    out = empty_aligned((len(values),), np.float32)
    out[:] = values
    return out


@kernel()
def powers_of(values, table, by_table, by_constants, logarithms):
    for i in range(0, values.shape[0], LANES):
        x = memory.load(values, i)
        memory.store(by_table, i, exp2_in_memory(x, table))
        memory.store(by_constants, i, simd.exp2(x))
        memory.store(logarithms, i, simd.log2(x))


def powers_and_logarithms(given) -> tuple[np.ndarray, ...]:
    """The values, as float64, their powers of two by either function, and their logarithms."""
    values, *out = (aligned(given.astype(F)) for _ in range(4))
    powers_of(values, TABLES.powers, *out)
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
