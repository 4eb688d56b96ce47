"""Min-max normalisation of a map and its gradient: a = (d − min) / (max − min).

    dL/dd_i = g_i / r  − [i is the minimum] Σ g (1 − a) / r  − [i is the maximum] Σ g a / r,   r = max − min

Several equal extremes share their part evenly, as torch's min and max do.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64
ONE = F(1)


@kernel(free_sums=True)
def extreme_rows(start, stop, values, extremes):
    """extremes[y] = smallest, largest of row y."""
    for y in range(start, stop):
        row = values[y]
        low, high = row[0], row[0]
        for x in range(U(row.shape[0])):
            low, high = min(low, row[x]), max(high, row[x])
        extremes[y, 0], extremes[y, 1] = low, high


@kernel()
def normalise_rows(start, stop, values, low, inverse_range, out):
    for y in range(start, stop):
        row, target = values[y], out[y]
        for x in range(U(row.shape[0])):
            target[x] = (row[x] - low) * inverse_range


@kernel(free_sums=True)
def pull_rows(start, stop, grad, normalised, sums):
    """sums[y] = Σ g (1 − a), Σ g a, and how many pixels of row y are the minimum and the maximum."""
    for y in range(start, stop):
        g, a = grad[y], normalised[y]
        to_low, to_high, n_low, n_high = 0.0, 0.0, 0.0, 0.0
        for x in range(U(g.shape[0])):
            to_high += np.float64(g[x] * a[x])
            to_low += np.float64(g[x] * (ONE - a[x]))
            n_low += 1.0 if a[x] == F(0) else 0.0
            n_high += 1.0 if a[x] == ONE else 0.0
        sums[y, 0], sums[y, 1], sums[y, 2], sums[y, 3] = to_low, to_high, n_low, n_high


@kernel()
def spread_rows(start, stop, grad, normalised, inverse_range, at_low, at_high, out):
    for y in range(start, stop):
        g, a, target = grad[y], normalised[y], out[y]
        for x in range(U(g.shape[0])):
            extra = at_low if a[x] == F(0) else (at_high if a[x] == ONE else F(0))
            target[x] = (g[x] - extra) * inverse_range


def normalise(values: np.ndarray, min_range: float) -> tuple[np.ndarray, float] | None:
    """The normalised map (H, W) and 1 / range; None where the range is below `min_range`."""
    bands = pool.chunks(len(values), min(len(values), pool.get_threads()))
    extremes = np.empty((len(values), 2), np.float32)
    pool.run(extreme_rows, [(*band, values, extremes) for band in bands])
    low, high = extremes[:, 0].min(), extremes[:, 1].max()
    if not high - low >= min_range:
        return None
    out, inverse_range = np.empty_like(values), F(1) / (high - low)
    pool.run(normalise_rows, [(*band, values, low, inverse_range, out) for band in bands])
    out[values == high] = 1.0  # exactly, whatever the rounding: the gradient finds the extremes by it
    return out, float(inverse_range)


def normalise_gradient(grad: np.ndarray, normalised: np.ndarray, inverse_range: float) -> np.ndarray:
    """The gradient by the map, given that by the normalised map."""
    bands = pool.chunks(len(grad), min(len(grad), pool.get_threads()))
    sums = np.empty((len(grad), 4), np.float64)
    pool.run(pull_rows, [(*band, grad, normalised, sums) for band in bands])
    to_low, to_high, n_low, n_high = sums.sum(axis=0)
    shares = F(inverse_range), F(to_low / n_low), F(to_high / n_high)
    out = np.empty_like(grad)
    pool.run(spread_rows, [(*band, grad, normalised, *shares, out) for band in bands])
    return out


@kernel()
def inverse_rows(start, stop, depth, transmittance, min_alpha, out):
    """out = alpha / accumulated depth, the inverse of the expected depth; 0 where alpha ≤ min_alpha."""
    for y in range(start, stop):
        d, t, target = depth[y], transmittance[y], out[y]
        for x in range(U(d.shape[0])):
            alpha = ONE - t[x]
            target[x] = alpha / d[x] if alpha > min_alpha else F(0)


@kernel()
def inverse_gradient_rows(start, stop, grad, depth, transmittance, min_alpha, grad_depth, grad_transmittance):
    """d(alpha / depth): −alpha / depth² by the depth, −1 / depth by the transmittance."""
    for y in range(start, stop):
        g, d, t, by_d, by_t = grad[y], depth[y], transmittance[y], grad_depth[y], grad_transmittance[y]
        for x in range(U(d.shape[0])):
            alpha = ONE - t[x]
            pull = g[x] / d[x] if alpha > min_alpha else F(0)
            by_t[x] = -pull
            by_d[x] = -pull * alpha / d[x] if alpha > min_alpha else F(0)


def inverse_depth(depth: np.ndarray, transmittance: np.ndarray, min_alpha: float) -> np.ndarray:
    """Map (H, W) of inverse expected depths."""
    out = np.empty_like(depth)
    bands = pool.chunks(len(depth), min(len(depth), pool.get_threads()))
    pool.run(inverse_rows, [(*band, depth, transmittance, F(min_alpha), out) for band in bands])
    return out


def inverse_depth_gradient(grad, depth, transmittance, min_alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """The gradients by depth and by transmittance, given that by the inverse depth."""
    out = np.empty_like(depth), np.empty_like(depth)
    bands = pool.chunks(len(depth), min(len(depth), pool.get_threads()))
    pool.run(inverse_gradient_rows, [(*band, grad, depth, transmittance, F(min_alpha), *out) for band in bands])
    return out
