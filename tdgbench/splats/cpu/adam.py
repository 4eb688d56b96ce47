"""Adam (Kingma & Ba 2015) on rows that a step touched, exact for those it did not touch.

An untouched row goes on moving: its moments fade, m ← β1 m and v ← β2 v, and it coasts by  c_s ρ^j m / √v  at the j-th
such step s, with ρ = β1 / √β2 and c_s = rate_s √(1 − β2^s) / (1 − β1^s). Those steps are summed when the row is next
looked at. What differs from torch.optim.Adam is rounding, and while coasting eps = 1e-15 beside a √v of that size: then
it is `still` = eps √(1 − β2^now). It cannot be left out: where g² is too small for float32, v is 0 and m is not.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.columns import SCALES_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import load, prefetch_columns, store
from tdgbench.splats.cpu.simd.reductions import any_positive
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, is_finite, maximum, select, square_root

F, U = np.float32, np.uint64
AHEAD = 6  # rows for which memory is asked before they are worked on


@kernel(inline=True)
def note_bounds(bounds, i, row, parameters):
    """What culling looks at: the mean and the largest logarithm of a deviation."""
    for j in range(U(3)):
        bounds[i, j] = parameters[row + j]
    s = row + U(SCALES_AT)
    bounds[i, U(3)] = max(parameters[s], max(parameters[s + U(1)], parameters[s + U(2)]))


@kernel(inline=True)
def prefetch_row_of_each(i, columns, stride, parameters, first_moments, second_moments):
    """Ask for the row of Gaussian i in all three arrays, cache line by cache line."""
    prefetch_columns(parameters, i, stride, 0, columns)
    prefetch_columns(first_moments, i, stride, 0, columns)
    prefetch_columns(second_moments, i, stride, 0, columns)


@kernel(inline=True)
def coast(row, i, columns, stride, parameters, first_moments, second_moments, clocks, now, drift, rho_powers, still):
    """Move one row to where it is at `now`; its moments stay as they are."""
    behind = now - clocks[i, U(1)]
    faded = clocks[i, U(1)] - clocks[i, U(0)]
    if behind > 0:
        share = rho_powers[U(faded)]
        for j in range(0, columns, LANES):
            o = row + U(j)
            speed = divide(load(first_moments, o), square_root(load(second_moments, o)) + still)
            store(parameters, o, load(parameters, o) - speed * (load(drift, behind * stride + j) * share))
    clocks[i, U(1)] = now


@kernel()
def touched_rows(first, count, index, gradients, stride, parameters, first_moments, second_moments, bounds, clocks,
                 now, drift, rho_powers, still, powers1, powers2, step_sizes, per_bias2, rest1, rest2,
                 eps):  # fmt: skip
    """One step, the `now`-th, for the rows named by index[first : first + count]; drift is that of the step before.

    gradients (rows, g) with g ≤ stride, columns beyond being zero; parameters and moments flat, `stride` floats a row;
    powers[k] = β^k; step_sizes = rate / (1 − β1^t) and per_bias2 = 1 / √(1 − β2^t) for each column; clocks (N, 2): when
    the moments and the parameters of a row were last brought up to date. Returns whether all gradients are finite.
    """
    zero, one = broadcast(F(0)), broadcast(F(1))
    bad = zero
    columns = gradients.shape[1]
    flat = gradients.reshape(-1)
    last = U(first + count - 1)
    for r in range(U(first), U(first + count)):
        ahead = np.int64(index[min(r + U(AHEAD), last)])
        prefetch_row_of_each(ahead, columns, stride, parameters, first_moments, second_moments)
        i = U(index[r])
        behind = U(now - clocks[i, U(0)])
        fade1, fade2 = powers1[behind], powers2[behind]
        row, source = i * U(stride), r * U(columns)
        if clocks[i, U(1)] < now - 1:
            coast(
                row, i, columns, stride, parameters, first_moments, second_moments, clocks, now - 1, drift, rho_powers,
                still,
            )  # fmt: skip
        for j in range(0, columns, LANES):
            g = load(flat, source + U(j))
            bad = maximum(bad, select(is_finite(g), zero, one))
            o = row + U(j)
            m = load(first_moments, o) * fade1 + g * rest1
            v = load(second_moments, o) * fade2 + g * g * rest2
            store(first_moments, o, m)
            store(second_moments, o, v)
            move = divide(m, square_root(v) * load(per_bias2, j) + eps) * load(step_sizes, j)
            store(parameters, o, load(parameters, o) - move)
        clocks[i, U(0)] = now
        clocks[i, U(1)] = now
        note_bounds(bounds, i, row, parameters)
    return not any_positive(bad)


@kernel()
def coast_candidates(first, count, candidates, columns, stride, parameters, first_moments, second_moments, clocks, now,
                     drift, rho_powers, still):  # fmt: skip
    """Bring the parameters of candidates[first : first + count] up to date; `columns` of them are in use."""
    last = U(first + count - 1)
    for k in range(U(first), U(first + count)):
        ahead = np.int64(candidates[min(k + U(AHEAD), last)])
        prefetch_row_of_each(ahead, columns, stride, parameters, first_moments, second_moments)
        i = U(candidates[k])
        if clocks[i, U(1)] < now:
            coast(
                i * U(stride), i, columns, stride, parameters, first_moments, second_moments, clocks, now, drift,
                rho_powers, still,
            )  # fmt: skip


@kernel()
def settle_rows(start, stop, columns, stride, parameters, first_moments, second_moments, bounds, clocks, now, drift,
                rho_powers, still, powers1, powers2):  # fmt: skip
    """Bring parameters and moments of rows [start, stop) up to date."""
    for i in range(U(start), U(stop)):
        row = i * U(stride)
        coast(
            row, i, columns, stride, parameters, first_moments, second_moments, clocks, now, drift, rho_powers, still
        )  # fmt: skip
        behind = U(now - clocks[i, U(0)])
        if behind > U(0):
            for j in range(0, columns, LANES):
                o = row + U(j)
                store(first_moments, o, load(first_moments, o) * powers1[behind])
                store(second_moments, o, load(second_moments, o) * powers2[behind])
        clocks[i, U(0)] = now
        note_bounds(bounds, i, row, parameters)


@kernel()
def write_drift(count, now, stride, coefficients, rho, drift):
    """drift[k] = Σ_{j=1..k} c_{now−k+j} ρ^j for k ≤ count: how far k untouched steps carry, in units of m / √v.

    coefficients[s % len]: c of step s, for each column.
    """
    period = coefficients.shape[0]
    for c in range(U(stride)):
        drift[c] = F(0)
    for k in range(U(1), U(count + 1)):
        step = coefficients[U((now - np.int64(k) + 1) % period)]
        for c in range(U(stride)):
            drift[k * U(stride) + c] = rho * (step[c] + drift[(k - U(1)) * U(stride) + c])
