"""Adam (Kingma & Ba 2015) on the rows that have a gradient; the steps of all other rows are deferred.

A row without gradient keeps moving: its moments decay, m ← β1 m and v ← β2 v, and step s moves it by c_s ρ^j m / √v,
where j counts the steps since its last gradient, ρ = β1 / √β2 and c_s = rate_s √(1 − β2^s) / (1 − β1^s). These steps
are summed and applied when the row is next read. The result differs from torch.optim.Adam by rounding and by eps, which
enters all deferred steps as the eps √(1 − β2^t) of the step t that applies them. It cannot be dropped: where g²
underflows in float32, v is 0 and m is not.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load_anywhere, prefetch_columns, prefetch_row, store_anywhere
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, is_finite, select, square_root
from tdgbench.splats.cpu.statistics import StatisticsArrays, observe_gradients
from tdgbench.splats.gaussians import LEAST_COLUMNS, SCALES_AT
from tdgbench.splats.gradients import (
    BETA1,
    BETA2,
    EPS,
    BadColumns,
    ColumnFactors,
    Gradients,
    GradientStatistics,
    PendingGradients,
    Rows,
    RowSteps,
)

F, U = np.float32, np.uint64
PREFETCH_DISTANCE = 6  # rows
RHO = BETA1 / math.sqrt(BETA2)
FLUSH_EVERY = 128  # steps
# |m| / √v ≤ (1 − β1) / √(1 − β2) · √(Σ (β1² / β2)^j) by Cauchy and Schwarz: no step is longer than 7.3 rates.
MAX_SPEED = (1 - BETA1) / math.sqrt((1 - BETA2) * (1 - BETA1**2 / BETA2))
UPDATE_CONSTANTS = tuple(np.float32(c) for c in (1 - BETA1, 1 - BETA2, EPS))
STEPS_EACH = 8192  # rows that are worth a thread


class StepRows(NamedTuple):
    """Parameters and moments of N Gaussians, `stride` floats a row, of which the first `columns` are in use.

    They fill a register or more. Where they end within one, the last register begins earlier, and overlaps the one
    before: it is loaded before that is stored.
    """

    parameters: np.ndarray  # float32 (N · stride,)
    first: np.ndarray  # float32 (N · stride,): m
    second: np.ndarray  # float32 (N · stride,): v
    bounds: np.ndarray  # float32 (N, 4): mean (world units) and largest log scale, for culling
    clocks: np.ndarray  # int32 (N, 2): the steps up to which moments and parameters are current
    stride: int
    columns: int


class Deferred(NamedTuple):
    """Constants of deferred steps: the k steps up to `now` move a row by displacements[k] · ρ^j · m / (√v + eps)."""

    now: int  # the last step, counted from 1
    displacements: np.ndarray  # float32 ((steps + 1) · stride,), see `sum_displacements`
    rho_powers: np.ndarray  # float32 (steps,): ρ^j
    eps: np.float32  # eps √(1 − β2^t)


class Decay(NamedTuple):
    """Powers of β1 and β2: float32 (steps,) each."""

    first: np.ndarray
    second: np.ndarray


class Stale(NamedTuple):
    """Rows whose deferred steps are to be applied before they are read."""

    rows: StepRows
    deferred: Deferred
    flushed: int  # step up to which all rows are current


class AdamStep(NamedTuple):
    """One step; `deferred` ends with the step before."""

    rows: StepRows
    deferred: Deferred
    decay: Decay
    step_sizes: np.ndarray  # float32 (stride,): rate / (1 − β1^t) of each column
    per_bias2: np.ndarray  # float32 (stride,): 1 / √(1 − β2^t) of each column
    rest1: np.float32  # 1 − β1
    rest2: np.float32  # 1 − β2
    eps: np.float32


def _nothing() -> tuple[Stale, AdamStep]:
    """No row and no step, in the types of some: kernels are compiled once for both."""
    floats = np.zeros(0, np.float32)
    rows = StepRows(floats, floats, floats, np.zeros((0, 4), np.float32), np.zeros((0, 2), np.int32), 0, 0)
    deferred = Deferred(0, floats, floats, F(0))
    step = AdamStep(rows, deferred, Decay(floats, floats), floats, floats, F(0), F(0), F(0))
    return Stale(rows, deferred, 0), step


NO_STALE, NO_STEP = _nothing()


def new_flags(spans: int, step: AdamStep) -> np.ndarray:
    """Return (spans, columns of the state) float32 zeros, in which a step marks columns with bad gradients."""
    flags = empty_aligned((spans, step.rows.stride), np.float32)
    flags[:] = 0
    return flags


class DeferredSteps(RowSteps):
    """Steps of float32 rows. Call `flush` before reading the rows."""

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
        state, (rates, bias1, bias2) = self.state, factors
        columns = max(LEAST_COLUMNS, min(gradients.columns, state.values.shape[1]))
        columns = self._used = max(self._used, columns)  # the momentum of columns that this view lacks moves on
        roots = np.sqrt(bias2)
        step_sizes, per_bias2 = self._update_columns
        np.divide(rates, bias1, out=step_sizes, casting="same_kind")
        np.divide(1, roots, out=per_bias2, casting="same_kind")
        self._coefficients[state.now % FLUSH_EVERY] = rates * roots / bias1
        rows, deferred = self._rows(columns), self._deferred(state.now - 1)
        step = AdamStep(rows, deferred, self._decay, step_sizes, per_bias2, *UPDATE_CONSTANTS)
        observed = StatisticsArrays.of(statistics)
        bad = (
            step_computed(gradients, step, observed)
            if isinstance(gradients, Gradients)
            else gradients.step(step, observed)
        )
        since = state.now - self._flushed
        sum_displacements(since, state.now, self._coefficients, np.float32(RHO), self._displacements)
        if since >= FLUSH_EVERY - 1:
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


def step_computed(gradients: Gradients, step: AdamStep, statistics: StatisticsArrays) -> np.ndarray:
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


@kernel(inline=True)
def write_bounds(rows, i, row):
    """Store the mean and the largest log scale of Gaussian i, which starts at `row`, for culling."""
    for j in range(U(3)):
        rows.bounds[i, j] = rows.parameters[row + j]
    s = row + U(SCALES_AT)
    rows.bounds[i, U(3)] = max(rows.parameters[s], max(rows.parameters[s + U(1)], rows.parameters[s + U(2)]))


@kernel(inline=True)
def prefetch_gaussian(rows, i):
    """Prefetch the row of Gaussian i: parameters, moments and clocks."""
    prefetch_columns(rows.parameters, i, rows.stride, 0, rows.columns)
    prefetch_columns(rows.first, i, rows.stride, 0, rows.columns)
    prefetch_columns(rows.second, i, rows.stride, 0, rows.columns)
    prefetch_row(rows.clocks, U(i))


@kernel(inline=True)
def apply_deferred(rows, i, row, deferred):
    """Apply the deferred steps of Gaussian i, which starts at `row`; its moments stay as they are."""
    steps = deferred.now - rows.clocks[i, U(1)]
    decayed = rows.clocks[i, U(1)] - rows.clocks[i, U(0)]
    if steps > 0:
        decay, at, last = deferred.rho_powers[U(decayed)], steps * rows.stride, rows.columns - LANES
        of_last = load_anywhere(rows.parameters, row + U(last))
        for j in range(0, last, LANES):
            o = row + U(j)
            move_register(rows, o, load_anywhere(rows.parameters, o), deferred, at + j, decay)
        move_register(rows, row + U(last), of_last, deferred, at + last, decay)
    rows.clocks[i, U(1)] = deferred.now


@kernel(inline=True)
def move_register(rows, o, parameters, deferred, at, decay):
    """Move the register of parameters at o by its deferred steps, whose displacements are at `at`."""
    speed = divide(load_anywhere(rows.first, o), square_root(load_anywhere(rows.second, o)) + deferred.eps)
    displacement = load_anywhere(deferred.displacements, at) * decay
    store_anywhere(rows.parameters, o, parameters - speed * displacement)


@kernel(inline=True)
def step_row(step, i, gradients, source, bad):
    """Step Gaussian i by the gradients (any,) float32 that begin at `source`; columns beyond rows.columns have none.

    bad (stride,) float32: becomes 1 in columns whose gradient is not finite.
    """
    rows, deferred = step.rows, step.deferred
    now = deferred.now + 1
    steps = U(now - rows.clocks[i, U(0)])
    decay = step.decay.first[steps], step.decay.second[steps]
    row, last = i * U(rows.stride), rows.columns - LANES
    if rows.clocks[i, U(1)] < deferred.now:
        apply_deferred(rows, i, row, deferred)
    # Gradients are loaded before moments: LLVM orders sums by their loads, and so chooses which product is fused.
    g_last = load_anywhere(gradients, source + U(last))
    of_last = registers_at(rows, row + U(last))
    for j in range(0, last, LANES):
        g, o = load_anywhere(gradients, source + U(j)), row + U(j)
        step_register(rows, o, registers_at(rows, o), g, decay, step, j, bad)
    step_register(rows, row + U(last), of_last, g_last, decay, step, last, bad)
    rows.clocks[i, U(0)] = now
    rows.clocks[i, U(1)] = now
    write_bounds(rows, i, row)


@kernel(inline=True)
def registers_at(rows, o):
    """Parameters and moments at o."""
    return load_anywhere(rows.parameters, o), load_anywhere(rows.first, o), load_anywhere(rows.second, o)


@kernel(inline=True)
def step_register(rows, o, before, g, decay, step, j, bad):
    """Step the register at o, column j and those after it, by its gradient g; before: `registers_at` o."""
    parameters, m, v = before
    store_anywhere(bad, j, select(is_finite(g), load_anywhere(bad, j), broadcast(F(1))))
    m = m * decay[0] + g * step.rest1
    v = v * decay[1] + g * g * step.rest2
    store_anywhere(rows.first, o, m)
    store_anywhere(rows.second, o, v)
    per_bias2, step_sizes = load_anywhere(step.per_bias2, j), load_anywhere(step.step_sizes, j)
    move = divide(m, square_root(v) * per_bias2 + step.eps) * step_sizes
    store_anywhere(rows.parameters, o, parameters - move)


@kernel()
def step_rows(first, count, index, gradients, step, bad):
    """Step the rows index[first : first + count], int32 (capacity,), by gradients, float32 (capacity, columns or more).

    step: AdamStep. bad (stride,) float32: becomes 1 in columns with a gradient that is not finite.
    """
    flat, rows, stride = gradients.reshape(-1), step.rows, U(gradients.shape[1])
    last = U(first + count - 1)
    for r in range(U(first), U(first + count)):
        prefetch_gaussian(rows, np.int64(index[min(r + U(PREFETCH_DISTANCE), last)]))
        step_row(step, U(index[r]), flat, r * stride, bad)


@kernel()
def flush_rows(start, stop, rows, deferred, decay):
    """Bring parameters, moments and bounds of rows [start, stop) up to date."""
    for i in range(U(start), U(stop)):
        row = i * U(rows.stride)
        apply_deferred(rows, i, row, deferred)
        steps = U(deferred.now - rows.clocks[i, U(0)])
        if steps > U(0):
            last = rows.columns - LANES
            _, m, v = registers_at(rows, row + U(last))
            for j in range(0, last, LANES):
                o = row + U(j)
                store_anywhere(rows.first, o, load_anywhere(rows.first, o) * decay.first[steps])
                store_anywhere(rows.second, o, load_anywhere(rows.second, o) * decay.second[steps])
            store_anywhere(rows.first, row + U(last), m * decay.first[steps])
            store_anywhere(rows.second, row + U(last), v * decay.second[steps])
        rows.clocks[i, U(0)] = deferred.now
        write_bounds(rows, i, row)


@kernel()
def sum_displacements(count, now, coefficients, rho, displacements):
    """displacements[k] = Σ_{j=1..k} c_{now−k+j} ρ^j for k ≤ count: how far the last k steps move a row, × m / √v.

    coefficients: float32 (period, stride), c of step s in row s % period.
    displacements: float32 ((count + 1) · stride,).
    """
    period, stride = coefficients.shape
    for c in range(U(stride)):
        displacements[c] = F(0)
    for k in range(U(1), U(count + 1)):
        step = coefficients[U((now - np.int64(k) + 1) % period)]
        for c in range(U(stride)):
            displacements[k * U(stride) + c] = rho * (step[c] + displacements[(k - U(1)) * U(stride) + c])
