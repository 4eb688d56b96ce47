"""2^x for kernels whose registers are all taken.

The compiler broadcasts a coefficient that it knows at every use; one that lies in memory is an operand there.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load
from tdgbench.splats.cpu.simd.registers import EXP2, LANES, exp2_by


def _coefficients() -> np.ndarray:
    table = empty_aligned((len(EXP2), LANES), np.float32)
    table[:] = np.array(EXP2, np.float32)[:, None]
    return table.reshape(-1)


COEFFICIENTS = _coefficients()  # (6 · LANES,) float32: each coefficient of `exp2` as a register


@kernel(inline=True)
def exp2_in_memory(x, table):
    """2^x to 2.5e-7 relative for a register x, |x| < 126; table is COEFFICIENTS."""
    first = (load(table, 0), load(table, LANES), load(table, 2 * LANES))
    return exp2_by(x, (*first, load(table, 3 * LANES), load(table, 4 * LANES), load(table, 5 * LANES)))
