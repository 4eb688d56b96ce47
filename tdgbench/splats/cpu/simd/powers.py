"""2^x for kernels whose registers are all taken.

A coefficient that the compiler knows it broadcasts anew at every use; one that stands in memory is an operand there.
"""

from __future__ import annotations

import functools

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load
from tdgbench.splats.cpu.simd.registers import EXP2, EXP2_ROUGH, LANES, exp2_by


@functools.cache
def coefficients(rough: bool) -> np.ndarray:
    """What `exp2_exactly` or `exp2_roughly` needs, each coefficient as a register."""
    values = np.array(EXP2_ROUGH if rough else EXP2, np.float32)
    table = empty_aligned((len(values), LANES), np.float32)
    table[:] = values[:, None]
    return table.reshape(-1)


@kernel(inline=True)
def exp2_roughly(x, table):
    """2^x to 7.5e-5 relative."""
    return exp2_by(x, (load(table, 0), load(table, LANES), load(table, 2 * LANES), load(table, 3 * LANES)))


@kernel(inline=True)
def exp2_exactly(x, table):
    """2^x to 2.5e-7 relative."""
    first = (load(table, 0), load(table, LANES), load(table, 2 * LANES))
    return exp2_by(x, (*first, load(table, 3 * LANES), load(table, 4 * LANES), load(table, 5 * LANES)))
