import numpy as np
import pytest

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd import memory, powers
from tdgbench.splats.cpu.simd.registers import LANES
from tests.splats.cpu.simd.test_registers import aligned

F = np.float32


@kernel()
def exactly(values, table, out):
    for i in range(0, values.shape[0], LANES):
        memory.store(out, i, powers.exp2_exactly(memory.load(values, i), table))


@kernel()
def roughly(values, table, out):
    for i in range(0, values.shape[0], LANES):
        memory.store(out, i, powers.exp2_roughly(memory.load(values, i), table))


@pytest.mark.parametrize("run, rough, least, allowed", [(exactly, False, 0, 2.5e-7), (roughly, True, 1e-5, 7.6e-5)])
def test_powers_of_two(run, rough, least, allowed):
    values = aligned(np.linspace(-125, 125, 4096 * LANES).astype(F))
    out = aligned(np.zeros(len(values), F))
    run(values, powers.coefficients(rough), out)
    error = np.abs(out / np.exp2(values.astype(np.float64)) - 1).max()
    assert least < error < allowed
