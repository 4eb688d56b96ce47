"""Gradients of some rows, and the deferred steps of some, as the projection applies them to the rows that it reads."""

from __future__ import annotations

import numpy as np
import torch

from tdgbench.splats.cpu.adam import apply_deferred
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState


@kernel()
def _apply(index, rows, deferred):
    for i in index:
        if rows.clocks[i, 1] < deferred.now:
            apply_deferred(rows, i, i * rows.stride, deferred)


def apply_deferred_steps(optimizer: Adam, index: np.ndarray) -> None:
    """Apply the deferred steps of the rows of index, int32 (n,)."""
    stale = optimizer.row_steps.stale()
    if stale.deferred.now > stale.flushed:
        _apply(index, stale.rows, stale.deferred)


def step_gradients(state: TrainingState, step: int, share: float) -> Gradients:
    """Random gradients for a random share of the Gaussians, in two spans with a gap."""
    g = torch.Generator().manual_seed(step)
    index = (torch.rand(len(state), generator=g) < share).nonzero().squeeze(1).to(torch.int32)
    values = torch.zeros(len(index) + 3, state.values.shape[1], dtype=state.values.dtype)
    values[:, : state.columns] = torch.randn(len(values), state.columns, generator=g) * 10.0 ** (step % 7 - 4)
    half = len(index) // 2
    spans = [(0, half), (half + 3, len(index) - half)]
    padded = torch.cat([index[:half], torch.zeros(3, dtype=torch.int32), index[half:]])
    return Gradients(spans, padded, values, torch.zeros(len(padded), 3), [], padded[:0], padded[:0])
