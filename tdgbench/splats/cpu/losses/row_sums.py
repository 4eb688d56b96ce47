"""Sums over a row of floats, in an order that is fixed here and not chosen by the compiler.

A sum that the compiler may reorder comes out differently, in its last bits, where it is compiled in another context:
in the process that compiles a kernel, and in one that loads it from the machine-code cache.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import load_anywhere
from tdgbench.splats.cpu.simd.reductions import lane_sum
from tdgbench.splats.cpu.simd.registers import LANES, absolute, broadcast

F, U = np.float32, np.uint64
ZERO = F(0)


@kernel(inline=True)
def row_sum(values):
    """Σ values (columns,)."""
    count = U(values.shape[0])
    whole = count - count % U(LANES)
    partial = broadcast(ZERO)
    for x in range(U(0), whole, U(LANES)):
        partial = partial + load_anywhere(values, x)
    total = lane_sum(partial)
    for x in range(whole, count):
        total += values[x]
    return total


@kernel(inline=True)
def difference_sum(a, b, v, w):
    """Σ v w |a − b| of rows a and b (columns,), with the weights v and w of their values (columns,), or None."""
    count = U(a.shape[0])
    whole = count - count % U(LANES)
    partial = broadcast(ZERO)
    for x in range(U(0), whole, U(LANES)):
        difference = absolute(load_anywhere(a, x) - load_anywhere(b, x))
        if v is None:
            partial = partial + difference
        else:
            partial = partial + load_anywhere(v, x) * load_anywhere(w, x) * difference
    total = lane_sum(partial)
    for x in range(whole, count):
        if v is None:
            total += abs(a[x] - b[x])
        else:
            total += v[x] * w[x] * abs(a[x] - b[x])
    return total
