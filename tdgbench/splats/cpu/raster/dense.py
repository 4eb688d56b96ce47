"""Between the rows of the kernels and tensors of all N Gaussians, one for each parameter, as torch differentiates them.

Parameters: float32 means (N, 3), quats (N, 4), scales (N, 3), opacities (N, 1) and colors (N, any).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.gaussians import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT

U = np.uint64
MEANS, QUATS, SCALES, OPACITY, COLORS = map(U, (MEANS_AT, QUATS_AT, SCALES_AT, OPACITY_AT, COLORS_AT))


def to_rows(parameters: Sequence[np.ndarray], largest: np.ndarray, rows: np.ndarray, bounds: np.ndarray) -> None:
    """Fill rows (N, columns) with the parameters, and bounds (N, 4) with the means and the largest scales (N,)."""
    count = len(rows)
    calls = [(*piece, *parameters, largest, rows, bounds) for piece in pool.chunks(count, pool.get_threads())]
    pool.run(_gather, calls, items=count, each=pool.ROWS_EACH)


def of_rows(
    rows: np.ndarray, gaussian_ids: np.ndarray, spans: Sequence[tuple[int, int]], count: int, widths: Sequence[int]
) -> list[np.ndarray]:
    """Return arrays (count, width): consecutive columns of the spans (first, number) of rows, 0 for other Gaussians.

    The last is 0 in columns that rows lack: rows of gradients have those of the degree of harmonics that was rendered.
    """
    parts = [np.zeros((count, width), rows.dtype) for width in widths]
    scatter = _scatter if len(parts) == 1 else _scatter_parameters
    pool.run(scatter, [(*span, gaussian_ids, rows, *parts) for span in spans])
    return parts


@kernel()
def _gather(start, stop, means, quats, scales, opacities, colors, largest, rows, bounds):
    for i in range(U(start), U(stop)):
        for k in range(U(3)):
            rows[i, MEANS + k] = bounds[i, k] = means[i, k]
            rows[i, SCALES + k] = scales[i, k]
        for k in range(U(4)):
            rows[i, QUATS + k] = quats[i, k]
        rows[i, OPACITY] = opacities[i, U(0)]
        for k in range(U(colors.shape[1])):
            rows[i, COLORS + k] = colors[i, k]
        bounds[i, U(3)] = largest[i]


@kernel()
def _scatter_parameters(first, count, gaussian_ids, rows, means, quats, scales, opacities, colors):
    for r in range(U(first), U(first + count)):
        i = U(gaussian_ids[r])
        for k in range(U(3)):
            means[i, k] = rows[r, MEANS + k]
            scales[i, k] = rows[r, SCALES + k]
        for k in range(U(4)):
            quats[i, k] = rows[r, QUATS + k]
        opacities[i, U(0)] = rows[r, OPACITY]
        for k in range(min(U(colors.shape[1]), U(rows.shape[1]) - COLORS)):
            colors[i, k] = rows[r, COLORS + k]


@kernel()
def _scatter(first, count, gaussian_ids, rows, values):
    for r in range(U(first), U(first + count)):
        i = U(gaussian_ids[r])
        for k in range(min(U(values.shape[1]), U(rows.shape[1]))):
            values[i, k] = rows[r, k]
