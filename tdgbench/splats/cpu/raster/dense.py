"""From rows of some Gaussians to arrays of all, as torch's autograd needs them: what has no row becomes zero.

Rows are in ascending order of their Gaussians. A span of rows fills the arrays from its first Gaussian (the first
span: from 0) up to where the next span begins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.source import Span
from tdgbench.splats.cpu.raster.types import GradientRows, Projected
from tdgbench.splats.cpu.scratch import empty_aligned

U = np.uint64
ZERO = np.float32(0)


class DenseGradients(NamedTuple):
    """Gradients of all N Gaussians, float32."""

    means: np.ndarray  # (N, 3)
    quats: np.ndarray  # (N, 4)
    scales: np.ndarray  # (N, 3)
    opacities: np.ndarray  # (N,)
    colors: np.ndarray  # (N, numbers per Gaussian)
    means2d: np.ndarray  # (N, 2) per px


@kernel()
def spread_gradients(first, count, start, stop, rows, dense):
    """Fill Gaussians [start, stop) of `dense` (DenseGradients) from rows [first, first + count) (GradientArrays)."""
    used = U(min(dense.colors.shape[1], rows.values.shape[1] - COLORS_AT))
    r = U(first)
    for i in range(U(start), U(stop)):
        if r < U(first + count) and U(rows.gaussian_ids[r]) == i:
            copy_row(rows.values, r, dense, i, used)
            for j in range(U(2)):
                dense.means2d[i, j] = rows.image[r, j]
            r += U(1)
        else:
            clear_row(dense, i)


@kernel(inline=True)
def copy_row(values, r, dense, i, used):
    """Copy row r of values (n, columns) to Gaussian i, `used` numbers of its colours."""
    for j in range(U(3)):
        dense.means[i, j] = values[r, U(MEANS_AT) + j]
        dense.scales[i, j] = values[r, U(SCALES_AT) + j]
    for j in range(U(4)):
        dense.quats[i, j] = values[r, U(QUATS_AT) + j]
    dense.opacities[i] = values[r, U(OPACITY_AT)]
    for j in range(used):
        dense.colors[i, j] = values[r, U(COLORS_AT) + j]
    for j in range(used, U(dense.colors.shape[1])):
        dense.colors[i, j] = ZERO


@kernel(inline=True)
def clear_row(dense, i):
    """Zero the gradients of Gaussian i."""
    for j in range(U(3)):
        dense.means[i, j] = ZERO
        dense.scales[i, j] = ZERO
    for j in range(U(4)):
        dense.quats[i, j] = ZERO
    dense.opacities[i] = ZERO
    for j in range(U(dense.colors.shape[1])):
        dense.colors[i, j] = ZERO
    for j in range(U(2)):
        dense.means2d[i, j] = ZERO


@kernel()
def spread_projected(first, count, start, stop, projected, radii, means2d):
    """Fill Gaussians [start, stop) of radii (N,) int32 and means2d (N, 2) float32 from rows of Projected."""
    r = U(first)
    for i in range(U(start), U(stop)):
        if r < U(first + count) and U(projected.gaussian_ids[r]) == i:
            radii[i] = projected.radii[r]
            means2d[i, U(0)], means2d[i, U(1)] = projected.means2d[r, U(0)], projected.means2d[r, U(1)]
            r += U(1)
        else:
            radii[i] = 0
            means2d[i, U(0)], means2d[i, U(1)] = ZERO, ZERO


def _ranges(spans: list[Span], gaussian_ids: np.ndarray, count: int) -> list[tuple[int, int, int, int]]:
    """Return (first row, rows, first Gaussian, end) of every span that has rows; together they cover all Gaussians."""
    spans = [span for span in spans if span[1] > 0] or [(0, 0)]
    starts = [0, *(int(gaussian_ids[first]) for first, _ in spans[1:]), count]
    return [(*span, starts[t], starts[t + 1]) for t, span in enumerate(spans)]


def dense_gradients(rows: GradientRows, count: int, colors: int) -> DenseGradients:
    """Return gradients of all `count` Gaussians, `colors` numbers each for their colours."""
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, colors), (count, 2))
    out = DenseGradients(*(empty_aligned(shape, np.float32) for shape in shapes))
    ranges = _ranges(rows.spans, rows.arrays.gaussian_ids, count)
    pool.run(spread_gradients, [(*r, rows.arrays, out) for r in ranges])
    return out


def dense_projected(projected: Projected, spans: list[Span], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return radii (N,) int32 and image means (N, 2), px, of all Gaussians; 0 for those that were not projected."""
    out = empty_aligned((count,), np.int32), empty_aligned((count, 2), np.float32)
    pool.run(spread_projected, [(*r, projected, *out) for r in _ranges(spans, projected.gaussian_ids, count)])
    return out
