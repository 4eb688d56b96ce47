"""Min-max normalisation of a map and its gradient: a = (d − min) / (max − min).

    dL/dd_i = g_i / r  − [i is the minimum] Σ g (1 − a) / r  − [i is the maximum] Σ g a / r,   r = max − min

Pixels that tie for an extreme share its part evenly, as with torch's min and max.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64
ONE = F(1)


@kernel(free_sums=True)
def extreme_rows(start, stop, values, extremes):
    """extremes[y] = minimum, maximum of row y; values (rows, columns), extremes (rows, 2)."""
    for y in range(start, stop):
        row = values[y]
        low, high = row[0], row[0]
        for x in range(U(row.shape[0])):
            low, high = min(low, row[x]), max(high, row[x])
        extremes[y, 0], extremes[y, 1] = low, high


@kernel()
def normalise_rows(start, stop, values, low, inverse_range, out):
    """out = (values − low) · inverse_range in rows [start, stop); values, out (rows, columns)."""
    for y in range(start, stop):
        row, target = values[y], out[y]
        for x in range(U(row.shape[0])):
            target[x] = (row[x] - low) * inverse_range


@kernel(free_sums=True)
def sum_rows(start, stop, grad, normalised, sums):
    """sums[y] = Σ g (1 − a), Σ g a, and the number of minima and of maxima in row y.

    grad, normalised: (rows, columns); sums: float64 (rows, 4).
    """
    for y in range(start, stop):
        g, a = grad[y], normalised[y]
        low_sum, high_sum, n_low, n_high = 0.0, 0.0, 0.0, 0.0
        for x in range(U(g.shape[0])):
            high_sum += np.float64(g[x] * a[x])
            low_sum += np.float64(g[x] * (ONE - a[x]))
            n_low += 1.0 if a[x] == F(0) else 0.0
            n_high += 1.0 if a[x] == ONE else 0.0
        sums[y, 0], sums[y, 1], sums[y, 2], sums[y, 3] = low_sum, high_sum, n_low, n_high


@kernel()
def normalise_gradient_rows(start, stop, grad, normalised, inverse_range, at_low, at_high, out):
    """out = (g − at_low or at_high at an extreme) · inverse_range in rows [start, stop); arrays (rows, columns)."""
    for y in range(start, stop):
        g, a, target = grad[y], normalised[y], out[y]
        for x in range(U(g.shape[0])):
            extra = at_low if a[x] == F(0) else (at_high if a[x] == ONE else F(0))
            target[x] = (g[x] - extra) * inverse_range


def normalise(values: np.ndarray, min_range: float) -> tuple[np.ndarray, float] | None:
    """Return the normalised map (H, W) of float32 values (H, W), and 1 / range; None for one below `min_range`.

    >>> out, inverse_range = normalise(np.array([[1.0, 2.0], [3.0, 5.0]], np.float32), 1e-8)
    >>> out.tolist(), inverse_range
    ([[0.0, 0.25], [0.5, 1.0]], 0.25)
    """
    extremes = np.empty((len(values), 2), np.float32)
    pool.run_bands(extreme_rows, len(values), values, extremes)
    low, high = extremes[:, 0].min(), extremes[:, 1].max()
    if not high - low >= min_range:
        return None
    out, inverse_range = np.empty_like(values), F(1) / (high - low)
    pool.run_bands(normalise_rows, len(values), values, low, inverse_range, out)
    out[values == high] = 1.0  # exactly: the gradient finds the maxima by it
    return out, float(inverse_range)


def normalise_gradient(grad: np.ndarray, normalised: np.ndarray, inverse_range: float) -> np.ndarray:
    """Return the gradient (H, W) by the map, from the one by the normalised map (H, W)."""
    sums = np.empty((len(grad), 4), np.float64)
    pool.run_bands(sum_rows, len(grad), grad, normalised, sums)
    low_sum, high_sum, n_low, n_high = sums.sum(axis=0)
    shares = F(inverse_range), F(low_sum / n_low), F(high_sum / n_high)
    out = np.empty_like(grad)
    pool.run_bands(normalise_gradient_rows, len(grad), grad, normalised, *shares, out)
    return out


@kernel()
def inverse_rows(start, stop, depth, transmittance, min_alpha, out):
    """out = alpha / depth, the inverse of the expected depth; 0 where alpha ≤ min_alpha. Maps (rows, columns)."""
    for y in range(start, stop):
        d, t, target = depth[y], transmittance[y], out[y]
        for x in range(U(d.shape[0])):
            alpha = ONE - t[x]
            target[x] = alpha / d[x] if alpha > min_alpha else F(0)


@kernel()
def inverse_gradient_rows(start, stop, grad, depth, transmittance, min_alpha, grad_depth, grad_transmittance):
    """Gradient of alpha / depth: −alpha / depth² by depth, −1 / depth by transmittance. Maps (rows, columns)."""
    for y in range(start, stop):
        g, d, t, by_d, by_t = grad[y], depth[y], transmittance[y], grad_depth[y], grad_transmittance[y]
        for x in range(U(d.shape[0])):
            alpha = ONE - t[x]
            slope = g[x] / d[x] if alpha > min_alpha else F(0)
            by_t[x] = -slope
            by_d[x] = -slope * alpha / d[x] if alpha > min_alpha else F(0)


def inverse_depth(depth: np.ndarray, transmittance: np.ndarray, min_alpha: float) -> np.ndarray:
    """Return the inverse expected depth (H, W), from accumulated depth (H, W) and transmittance (H, W)."""
    out = np.empty_like(depth)
    pool.run_bands(inverse_rows, len(depth), depth, transmittance, F(min_alpha), out)
    return out


def inverse_depth_gradient(grad, depth, transmittance, min_alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """Return gradients (H, W) by depth and by transmittance, from the one by the inverse depth (H, W)."""
    out = np.empty_like(depth), np.empty_like(depth)
    pool.run_bands(inverse_gradient_rows, len(depth), grad, depth, transmittance, F(min_alpha), *out)
    return out
