import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd import memory, powers
from tdgbench.splats.cpu.simd.registers import LANES
from tests.splats.cpu.simd.arrays import aligned

F = np.float32


@kernel()
def powers_of(values, table, out):
    for i in range(0, values.shape[0], LANES):
        memory.store(out, i, powers.exp2_in_memory(memory.load(values, i), table))


def test_powers_of_two():
    values = aligned(np.linspace(-125, 125, 4096 * LANES).astype(F))
    out = aligned(np.zeros(len(values), F))
    powers_of(values, powers.COEFFICIENTS, out)
    error = np.abs(out / np.exp2(values.astype(np.float64)) - 1).max()
    assert 0 < error < 2.5e-7


@kernel()
def exponential(values, out):
    for i in range(0, values.shape[0], LANES):
        memory.store(out, i, powers.exp2(memory.load(values, i)))


def test_exp2():
    values = aligned(np.linspace(-125, 125, 4096 * LANES).astype(F))
    out = aligned(np.zeros(len(values), F))
    exponential(values, out)
    exact = np.exp2(values.astype(np.float64))
    assert np.abs(out / exact - 1).max() < 2.5e-7


@kernel()
def logarithm(values, out):
    for i in range(0, values.shape[0], LANES):
        memory.store(out, i, powers.log2(memory.load(values, i)))


def test_log2():
    near_one, wide = np.linspace(0.5, 2, 1024 * LANES), np.exp2(np.linspace(-120, 120, 1024 * LANES))
    for given, relative, absolute in ((near_one, 0, 1e-7), (wide, 2e-7, 2e-7)):
        values = aligned(given.astype(F))
        out = aligned(np.zeros(len(values), F))
        logarithm(values, out)
        assert np.allclose(out, np.log2(values.astype(np.float64)), rtol=relative, atol=absolute)
