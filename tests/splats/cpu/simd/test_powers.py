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
