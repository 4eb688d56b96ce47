"""Steps of Adam on the CPU: only rows with a gradient are stepped, the steps of all others are deferred."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from tdgbench.splats.columns import LEAST_COLUMNS
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import (
    AdamStep,
    Decay,
    Deferred,
    Stale,
    StepRows,
    Update,
    flush_rows,
    new_flags,
    step_rows,
    sum_displacements,
)
from tdgbench.splats.cpu.raster.passes import Blended
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.statistics import StatisticsArrays, observe_gradients
from tdgbench.splats.gradients import Gradients, GradientStatistics, PendingGradients
from tdgbench.splats.stepping import BETA1, BETA2, EPS, BadColumns, ColumnFactors, Rows, RowSteps

RHO = BETA1 / math.sqrt(BETA2)
FLUSH_EVERY = 128  # steps
# |m| / √v ≤ (1 − β1) / √(1 − β2) · √(Σ (β1² / β2)^j) by Cauchy and Schwarz: no step is longer than 7.3 rates.
MAX_SPEED = (1 - BETA1) / math.sqrt((1 - BETA2) * (1 - BETA1**2 / BETA2))
UPDATE_CONSTANTS = tuple(np.float32(c) for c in (1 - BETA1, 1 - BETA2, EPS))
STEPS_EACH = 8192  # rows that are worth a thread


class DeferredSteps(RowSteps):
    """Steps of float32 rows on the CPU; see `tdgbench.splats.cpu.adam`. Call `flush` before reading the rows."""

    most_deferred = MAX_SPEED * RHO / (1 - RHO)
    longest_deferral = FLUSH_EVERY

    def __init__(self, state: Rows) -> None:
        super().__init__(state)
        self._flushed = 0  # step of the last flush
        self._used = 0  # columns that ever had a gradient
        width = state.values.shape[1]
        self._update_columns = empty_aligned((2, width), np.float32)
        self._coefficients = torch.zeros(FLUSH_EVERY, width).numpy()  # by step: rate √(1 − β2^t) / (1 − β1^t)
        self._displacements = torch.zeros((FLUSH_EVERY + 1) * width).numpy()
        exponents = np.arange(FLUSH_EVERY + 2, dtype=np.float64)
        self._decay = Decay(*((beta**exponents).astype(np.float32) for beta in (BETA1, BETA2)))
        self._rho_powers = (RHO**exponents).astype(np.float32)

    def take(
        self,
        gradients: Gradients | PendingGradients,
        factors: ColumnFactors,
        statistics: GradientStatistics | None = None,
    ) -> BadColumns:
        assert isinstance(gradients, Gradients | Blended)
        state, (rates, bias1, bias2) = self.state, factors
        columns = max(LEAST_COLUMNS, min(gradients.columns, state.values.shape[1]))
        self._used = max(self._used, columns)
        roots = np.sqrt(bias2)
        step_sizes, per_bias2 = self._update_columns
        np.divide(rates, bias1, out=step_sizes, casting="same_kind")
        np.divide(1, roots, out=per_bias2, casting="same_kind")
        self._coefficients[state.now % FLUSH_EVERY] = rates * roots / bias1
        update = Update(step_sizes, per_bias2, *UPDATE_CONSTANTS)
        step = AdamStep(self._rows(columns), self._deferred(state.now - 1), self._decay, update)
        observed = StatisticsArrays.of(statistics)
        bad = gradients.step(step, observed) if isinstance(gradients, Blended) else _step(gradients, step, observed)
        deferred = state.now - self._flushed
        sum_displacements(deferred, state.now, self._coefficients, np.float32(RHO), self._displacements)
        if deferred >= FLUSH_EVERY - 1:
            self.flush()
        return bad if bad.any() else None

    def stale(self) -> Stale:
        """Return all rows with their deferred steps, which a kernel applies to a row before it reads the row."""
        return Stale(self._rows(self._used), self._deferred(self.state.now), self._flushed)

    def flush(self) -> None:
        if self.state.now == self._flushed:
            return
        common = (self._rows(self._used), self._deferred(self.state.now), self._decay)
        pool.run(flush_rows, [(*part, *common) for part in pool.chunks(len(self.state.values), pool.get_threads())])
        self._flushed = self.state.now

    def state_dict(self) -> dict[str, Any]:
        return {
            "flushed": self._flushed,
            "used": self._used,
            "coefficients": torch.from_numpy(self._coefficients),
            "displacements": torch.from_numpy(self._displacements),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        self._flushed, self._used = saved["flushed"], saved["used"]
        self._coefficients[:] = saved["coefficients"].numpy()
        self._displacements[:] = saved["displacements"].numpy()

    def _rows(self, columns: int) -> StepRows:
        """Return the state's memory, as the kernels take it."""
        values, first, second, bounds, clocks = self.state.arrays()
        flat = (values.reshape(-1), first.reshape(-1), second.reshape(-1))
        return StepRows(*flat, bounds, clocks, values.shape[1], columns)

    def _deferred(self, last: int) -> Deferred:
        """Return constants of the deferred steps up to step `last`."""
        eps = np.float32(EPS * math.sqrt(1 - BETA2 ** max(self.state.now, 1)))
        return Deferred(last, self._displacements, self._rho_powers, eps)


def _step(gradients: Gradients, step: AdamStep, statistics: StatisticsArrays) -> np.ndarray:
    """Take a step with computed gradients, and add them to the statistics. Returns what `Blended.step` does."""
    if statistics.active:
        observe_gradients(gradients, statistics)
    spans = gradients.spans
    if len(spans) == 1:  # of a backend that does not split its rows
        first, count = spans[0]
        spans = [(first + a, b - a) for a, b in pool.chunks(count, pool.threads_for(count, STEPS_EACH))]
    bad = new_flags(len(spans), step)
    missing, values = step.rows.columns - gradients.columns, gradients.values
    if missing > 0:
        values = torch.nn.functional.pad(values, (0, missing))
    rows = (gradients.index.numpy(), values.numpy(), step)
    pool.run(step_rows, [(*span, *rows, flags) for span, flags in zip(spans, bad, strict=True)])
    return bad
