"""The deferred steps of some rows, as the projection applies them to the rows that it reads."""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.adam import apply_deferred
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.optimizer import Adam


@kernel()
def _apply(index, rows, deferred):
    for i in index:
        if rows.clocks[i, 1] < deferred.now:
            apply_deferred(rows, i, i * rows.stride, deferred)


def apply_deferred_steps(optimizer: Adam, index: np.ndarray) -> None:
    """Apply the deferred steps of the rows of index, int32 (n,)."""
    stale = optimizer.stale()
    if stale.deferred.now > stale.flushed:
        _apply(index, stale.rows, stale.deferred)
