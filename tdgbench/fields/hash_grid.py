"""Multiresolution hash grid (Müller et al. 2022, "Instant Neural Graphics Primitives", §3)."""

from __future__ import annotations

import itertools
import math
import sys
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from tdgbench.fields.kernels import FEATURES, PRIMES, Level, add_gradients, encode_level
from tdgbench.splats.cpu import pool

INITIAL = 1e-4  # table entries are uniform in ± this (Müller et al., §4)
SAMPLES_EACH = 4096  # worth a thread


class HashGrid(nn.Module):
    """Features of positions, interpolated in `levels` grids from coarse to fine, whose corners have rows in a table.

    float32 on the CPU runs compiled kernels, unless positions need a gradient; all else runs in plain torch.
    """

    def __init__(self, levels: int, coarsest: int, finest: int, log2_rows: int, generator: torch.Generator) -> None:
        """coarsest, finest: cells along an axis. log2_rows: of a level at most. generator: of the table's values."""
        super().__init__()
        self.levels = levels_of(levels, coarsest, finest, 2**log2_rows)
        self._memory = _ReusedMemory()
        rows = self.levels[-1].first + self.levels[-1].rows
        self.table = nn.Parameter(INITIAL * (2 * torch.rand(rows, FEATURES, generator=generator) - 1))

    def forward(self, positions: Tensor) -> Tensor:
        """Return the features (N, FEATURES · levels) of positions (N, 3) in [0, 1], the coarsest first."""
        table = self.table
        runs_kernels = table.device.type == "cpu" and table.dtype == positions.dtype == torch.float32
        if runs_kernels and not positions.requires_grad:
            return _Encode.apply(positions.contiguous(), table, self.levels, self._memory)
        return torch.cat([interpolated(positions, table, level) for level in self.levels], dim=1)


def levels_of(count: int, coarsest: int, finest: int, most_rows: int) -> tuple[Level, ...]:
    """Return the levels: ⌊coarsest · b^l⌋ cells, so that the last one has `finest` (Müller et al., eq. 2 and 3).

    >>> [(level.cells, level.first, level.is_dense) for level in levels_of(3, 16, 64, 2**14)]
    [(16, 0, True), (32, 4913, False), (64, 21297, False)]
    """
    growth, first, levels = (finest / coarsest) ** (1 / max(count - 1, 1)), 0, list[Level]()
    for number in range(count):
        cells = math.floor(coarsest * growth**number + 1e-6)  # a power is slightly below the whole number
        side, is_dense = cells + 1, (cells + 1) ** 3 <= most_rows
        steps = (side, side**2) if is_dense else PRIMES
        levels.append(Level(cells, side**3 if is_dense else most_rows, first, is_dense, *steps))
        first += levels[-1].rows
    return tuple(levels)


def interpolated(positions: Tensor, table: Tensor, level: Level) -> Tensor:
    """Return the features (N, FEATURES) of positions (N, 3) at one level, in plain torch. table: of all levels."""
    scaled = positions * level.cells
    cell = scaled.detach().floor().clamp(0, level.cells - 1)
    share, corner, result = scaled - cell, cell.long(), torch.zeros_like(positions[:, :FEATURES])
    for offset in itertools.product((0, 1), repeat=3):
        shift = torch.tensor(offset, device=positions.device)
        weight = torch.where(shift.bool(), share, 1 - share).prod(dim=1, keepdim=True)
        x, y, z = ((corner + shift) * corner.new_tensor([1, level.step_y, level.step_z])).unbind(dim=1)
        row = x + y + z if level.is_dense else (x ^ y ^ z) & (level.rows - 1)
        result = result + weight * table[level.first + row]
    return result


class _ReusedMemory:
    """Zeros for a table's gradient, in the memory of the last one if nobody holds it: new pages cost a fault each."""

    def __init__(self) -> None:
        self._array = np.zeros((0, FEATURES), np.float32)

    def zeros(self, shape: tuple[int, ...]) -> Tensor:
        if self._array.shape != shape or sys.getrefcount(self._array) > 2:  # a tensor counts as one
            self._array = np.zeros(shape, np.float32)
        else:
            self._array.fill(0)
        return torch.from_numpy(self._array)


class _Encode(torch.autograd.Function):
    """The kernels: positions (N, 3) and table to features (N, FEATURES · levels), stored feature by feature."""

    @staticmethod
    def forward(ctx: Any, positions: Tensor, table: Tensor, levels: tuple[Level, ...], memory: _ReusedMemory) -> Tensor:
        out = torch.empty(FEATURES * len(levels), len(positions))
        ctx.save_for_backward(positions)
        ctx.levels, ctx.memory, ctx.shape = levels, memory, table.shape
        at, rows, features = (
            positions.numpy(),
            table.detach().numpy(),
            out.numpy().reshape(len(levels), FEATURES, len(positions)),
        )

        def run(start: int, stop: int) -> None:
            for level, of_level in zip(levels, features, strict=True):
                encode_level(start, stop, at, level, rows, of_level)

        pool.run(run, pool.chunks(len(at), pool.threads_for(len(at), SAMPLES_EACH)))
        return out.T

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, Tensor, None, None]:
        at, of_table = ctx.saved_tensors[0].numpy(), ctx.memory.zeros(ctx.shape)
        of_features = gradients[0].T.contiguous().numpy().reshape(len(ctx.levels), FEATURES, len(at))
        threads = min(len(ctx.levels), pool.threads_for(len(at), SAMPLES_EACH))

        def run(first: int) -> None:
            for number in range(first, len(ctx.levels), threads):
                add_gradients(at, ctx.levels[number], of_features[number], of_table.numpy())

        pool.run(run, [(thread,) for thread in range(threads)])
        return None, of_table, None, None
