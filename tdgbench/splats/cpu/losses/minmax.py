"""Fused kernels of depth maps: min-max normalisation and inverse expected depth, as in `tdgbench.splats.torch_losses`.

The gradient of a = (d − min) / r, r = max − min:

    dL/dd_i = g_i / r  − [i is the minimum] Σ g (1 − a) / r  − [i is the maximum] Σ g a / r

Pixels that tie for an extreme share its part evenly, as with torch's min and max.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.torch_losses import MIN_RANGE

F, U = np.float32, np.uint64
ONE = F(1)


def min_max(values: Tensor) -> Tensor:
    """`torch_losses.min_max` of a float32 map."""
    return _MinMax.apply(values)


def inverse_expected_depth(depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
    """`torch_losses.inverse_expected_depth` of float32 maps."""
    return _InverseDepth.apply(depth, transmittance, min_alpha)


def contiguous_array(tensor: Tensor) -> np.ndarray:
    """Return a tensor as an array of its memory, or of a contiguous copy."""
    return np.ascontiguousarray(tensor.detach().numpy())


class _MinMax(torch.autograd.Function):
    @staticmethod
    def forward(ctx, values: Tensor) -> Tensor:
        given = contiguous_array(values)
        extremes = np.empty((len(given), 2), np.float32)
        pool.run_bands(extreme_rows, len(given), given, extremes)
        low, high = extremes[:, 0].min(), extremes[:, 1].max()
        ctx.normalised = None
        if not high - low >= MIN_RANGE:
            return torch.zeros_like(values)
        ctx.normalised, ctx.inverse_range = np.empty_like(given), F(1) / (high - low)
        pool.run_bands(normalise_rows, len(given), given, low, ctx.inverse_range, ctx.normalised)
        ctx.normalised[given == high] = 1.0  # exactly: the gradient finds the maxima by it
        return torch.from_numpy(ctx.normalised)

    @staticmethod
    def backward(ctx, grad):
        if ctx.normalised is None:
            return torch.zeros_like(grad)
        given, sums = contiguous_array(grad), np.empty((len(grad), 4), np.float64)
        pool.run_bands(sum_rows, len(given), given, ctx.normalised, sums)
        low_sum, high_sum, n_low, n_high = sums.sum(axis=0)
        shares = ctx.inverse_range, F(low_sum / n_low), F(high_sum / n_high)
        out = np.empty_like(given)
        pool.run_bands(normalise_gradient_rows, len(given), given, ctx.normalised, *shares, out)
        return torch.from_numpy(out)


class _InverseDepth(torch.autograd.Function):
    @staticmethod
    def forward(ctx, depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
        ctx.inputs = contiguous_array(depth), contiguous_array(transmittance), F(min_alpha)
        out = np.empty_like(ctx.inputs[0])
        pool.run_bands(inverse_rows, len(out), *ctx.inputs, out)
        return torch.from_numpy(out)

    @staticmethod
    def backward(ctx, grad):
        out = np.empty_like(ctx.inputs[0]), np.empty_like(ctx.inputs[0])
        pool.run_bands(inverse_gradient_rows, len(grad), contiguous_array(grad), *ctx.inputs, *out)
        return *map(torch.from_numpy, out), None


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
