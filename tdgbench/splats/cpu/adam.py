"""Adam (Kingma & Ba 2015) on the rows that have a gradient; the steps of all other rows are deferred.

A row without gradient keeps moving: its moments decay, m ← β1 m and v ← β2 v, and step s moves it by c_s ρ^j m / √v,
where j counts the steps since its last gradient, ρ = β1 / √β2 and c_s = rate_s √(1 − β2^s) / (1 − β1^s). These steps
are summed and applied when the row is next read. The result differs from torch.optim.Adam by rounding and by eps, which
enters all deferred steps as the eps √(1 − β2^t) of the step t that applies them. It cannot be dropped: where g²
underflows in float32, v is 0 and m is not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import SCALES_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import load, prefetch_columns, prefetch_row, store
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, is_finite, select, square_root

F, U = np.float32, np.uint64
PREFETCH_DISTANCE = 6  # rows


class Rows(NamedTuple):
    """Parameters and moments of N Gaussians, `stride` floats a row, of which the first `columns` are in use."""

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

    rows: Rows
    deferred: Deferred
    flushed: int  # step up to which all rows are current


class Update(NamedTuple):
    """Constants of one step."""

    step_sizes: np.ndarray  # float32 (stride,): rate / (1 − β1^t) of each column
    per_bias2: np.ndarray  # float32 (stride,): 1 / √(1 − β2^t) of each column
    rest1: np.float32  # 1 − β1
    rest2: np.float32  # 1 − β2
    eps: np.float32


class AdamStep(NamedTuple):
    """One step; `deferred` ends with the step before."""

    rows: Rows
    deferred: Deferred
    decay: Decay
    update: Update


def _nothing() -> tuple[Stale, AdamStep]:
    """No row and no step, in the types of some: kernels are compiled once for both."""
    floats = np.zeros(0, np.float32)
    rows = Rows(floats, floats, floats, np.zeros((0, 4), np.float32), np.zeros((0, 2), np.int32), 0, 0)
    deferred = Deferred(0, floats, floats, F(0))
    return Stale(rows, deferred, 0), AdamStep(
        rows, deferred, Decay(floats, floats), Update(floats, floats, F(0), F(0), F(0))
    )


NO_STALE, NO_STEP = _nothing()


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
        decay = deferred.rho_powers[U(decayed)]
        for j in range(0, rows.columns, LANES):
            o = row + U(j)
            speed = divide(load(rows.first, o), square_root(load(rows.second, o)) + deferred.eps)
            displacement = load(deferred.displacements, steps * rows.stride + j) * decay
            store(rows.parameters, o, load(rows.parameters, o) - speed * displacement)
    rows.clocks[i, U(1)] = deferred.now


@kernel(inline=True)
def step_row(step, i, gradients, source, bad):
    """Step Gaussian i by the gradients (any,) float32 that begin at `source`; columns beyond rows.columns have none.

    bad (stride,) float32: becomes 1 in columns whose gradient is not finite.
    """
    rows, deferred, update = step.rows, step.deferred, step.update
    one = broadcast(F(1))
    now = deferred.now + 1
    steps = U(now - rows.clocks[i, U(0)])
    decay1, decay2 = step.decay.first[steps], step.decay.second[steps]
    row = i * U(rows.stride)
    if rows.clocks[i, U(1)] < deferred.now:
        apply_deferred(rows, i, row, deferred)
    for j in range(0, rows.columns, LANES):
        g = load(gradients, source + U(j))
        store(bad, j, select(is_finite(g), load(bad, j), one))
        o = row + U(j)
        m = load(rows.first, o) * decay1 + g * update.rest1
        v = load(rows.second, o) * decay2 + g * g * update.rest2
        store(rows.first, o, m)
        store(rows.second, o, v)
        move = divide(m, square_root(v) * load(update.per_bias2, j) + update.eps) * load(update.step_sizes, j)
        store(rows.parameters, o, load(rows.parameters, o) - move)
    rows.clocks[i, U(0)] = now
    rows.clocks[i, U(1)] = now
    write_bounds(rows, i, row)


@kernel()
def step_rows(first, count, index, gradients, step, bad):
    """Step the rows index[first : first + count], int32 (capacity,), by gradients, float32 (capacity, rows.columns).

    step: AdamStep. bad (stride,) float32: becomes 1 in columns with a gradient that is not finite.
    """
    flat, rows = gradients.reshape(-1), step.rows
    last = U(first + count - 1)
    for r in range(U(first), U(first + count)):
        prefetch_gaussian(rows, np.int64(index[min(r + U(PREFETCH_DISTANCE), last)]))
        step_row(step, U(index[r]), flat, r * U(rows.columns), bad)


@kernel()
def flush_rows(start, stop, rows, deferred, decay):
    """Bring parameters, moments and bounds of rows [start, stop) up to date."""
    for i in range(U(start), U(stop)):
        row = i * U(rows.stride)
        apply_deferred(rows, i, row, deferred)
        steps = U(deferred.now - rows.clocks[i, U(0)])
        if steps > U(0):
            for j in range(0, rows.columns, LANES):
                o = row + U(j)
                store(rows.first, o, load(rows.first, o) * decay.first[steps])
                store(rows.second, o, load(rows.second, o) * decay.second[steps])
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
