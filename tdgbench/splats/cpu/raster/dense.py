"""From rows of some Gaussians to arrays of all, as torch's autograd needs them: what has no row is zero."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.source import Span
from tdgbench.splats.cpu.raster.types import GradientRows, Projected

U = np.uint64


class DenseGradients(NamedTuple):
    """Gradients of all N Gaussians, float32."""

    means: np.ndarray  # (N, 3)
    quats: np.ndarray  # (N, 4)
    scales: np.ndarray  # (N, 3)
    opacities: np.ndarray  # (N,)
    colors: np.ndarray  # (N, numbers per Gaussian)
    means2d: np.ndarray  # (N, 2) per px
    absolute: np.ndarray  # (N, 2) per px, see `GradientArrays`; (N, 0) if it was not asked for


@kernel()
def spread_gradients(first, count, rows, dense):
    """Copy rows [first, first + count) (GradientArrays) to their Gaussians in `dense` (DenseGradients)."""
    values, image = rows.values, rows.image
    colors = range(U(min(dense.colors.shape[1], values.shape[1] - COLORS_AT)))
    for r in range(U(first), U(first + count)):
        i = U(rows.gaussian_ids[r])
        for j in range(U(3)):
            dense.means[i, j] = values[r, U(MEANS_AT) + j]
            dense.scales[i, j] = values[r, U(SCALES_AT) + j]
        for j in range(U(4)):
            dense.quats[i, j] = values[r, U(QUATS_AT) + j]
        dense.opacities[i] = values[r, U(OPACITY_AT)]
        for j in colors:
            dense.colors[i, j] = values[r, U(COLORS_AT) + j]
        for j in range(U(2)):
            dense.means2d[i, j] = image[r, j]
        for j in range(U(dense.absolute.shape[1])):
            dense.absolute[i, j] = image[r, U(3) + j]


@kernel()
def spread_projected(first, count, projected, radii, means2d):
    """Copy rows [first, first + count) of Projected to radii (N,) int32 and means2d (N, 2) float32."""
    for r in range(U(first), U(first + count)):
        i = U(projected.gaussian_ids[r])
        radii[i] = projected.radii[r]
        means2d[i, U(0)], means2d[i, U(1)] = projected.means2d[r, U(0)], projected.means2d[r, U(1)]


def dense_gradients(rows: GradientRows, count: int, colors: int) -> DenseGradients:
    """Return gradients of all `count` Gaussians, `colors` numbers each for their colours."""
    absolute = (count, rows.arrays.image.shape[1] - 3)
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, colors), (count, 2), absolute)
    out = DenseGradients(*(np.zeros(shape, np.float32) for shape in shapes))
    pool.run(spread_gradients, [(*span, rows.arrays, out) for span in rows.spans])
    return out


def dense_projected(projected: Projected, spans: list[Span], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return radii (N,) int32 and image means (N, 2), px, of all Gaussians; 0 for those that were not projected."""
    out = np.zeros(count, np.int32), np.zeros((count, 2), np.float32)
    pool.run(spread_projected, [(*span, projected, *out) for span in spans])
    return out
