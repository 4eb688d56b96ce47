"""From rows of some Gaussians to arrays of all, as torch's autograd wants them: what has no row becomes zero.

Rows are in ascending order of their Gaussians. A piece of rows fills the arrays from its first Gaussian (the first
piece: from 0) up to where the next piece begins.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.scratch import empty_aligned

U = np.uint64
ZERO = np.float32(0)


@kernel()
def spread_gradients(first, count, start, stop, index, rows, image, means, scales, quats, opacities, colors,
                     means2d):  # fmt: skip
    """Fill Gaussians [start, stop) of arrays (N, 3), (N, 3), (N, 4), (N,), (N, colours), (N, 2)."""
    width, used = U(colors.shape[1]), U(min(colors.shape[1], rows.shape[1] - COLORS_AT))
    r = U(first)
    for i in range(U(start), U(stop)):
        if r < U(first + count) and U(index[r]) == i:
            for j in range(U(3)):
                means[i, j] = rows[r, U(MEANS_AT) + j]
                scales[i, j] = rows[r, U(SCALES_AT) + j]
            for j in range(U(4)):
                quats[i, j] = rows[r, U(QUATS_AT) + j]
            opacities[i] = rows[r, U(OPACITY_AT)]
            for j in range(used):
                colors[i, j] = rows[r, U(COLORS_AT) + j]
            for j in range(used, width):
                colors[i, j] = ZERO
            for j in range(U(2)):
                means2d[i, j] = image[r, j]
            r += U(1)
        else:
            for j in range(U(3)):
                means[i, j] = ZERO
                scales[i, j] = ZERO
            for j in range(U(4)):
                quats[i, j] = ZERO
            opacities[i] = ZERO
            for j in range(width):
                colors[i, j] = ZERO
            for j in range(U(2)):
                means2d[i, j] = ZERO


@kernel()
def spread_projected(first, count, start, stop, seen, radii, means2d, all_radii, all_means2d):
    """Fill Gaussians [start, stop) of radii (N,) and image means (N, 2)."""
    r = U(first)
    for i in range(U(start), U(stop)):
        if r < U(first + count) and U(seen[r]) == i:
            all_radii[i] = radii[r]
            all_means2d[i, U(0)], all_means2d[i, U(1)] = means2d[r, U(0)], means2d[r, U(1)]
            r += U(1)
        else:
            all_radii[i] = 0
            all_means2d[i, U(0)], all_means2d[i, U(1)] = ZERO, ZERO


def _ranges(pieces: list[tuple[int, int]], index: np.ndarray, count: int) -> list[tuple[int, int, int, int]]:
    """(first row, rows, first Gaussian, end) of every piece that has rows; together they cover all Gaussians."""
    pieces = [piece for piece in pieces if piece[1] > 0] or [(0, 0)]
    starts = [0, *(int(index[first]) for first, _ in pieces[1:]), count]
    return [(*piece, starts[t], starts[t + 1]) for t, piece in enumerate(pieces)]


def dense_gradients(rows, count: int, colors: int) -> list[np.ndarray]:
    """Gradients of means, scales, quats, opacities, colours and image means."""
    shapes = ((count, 3), (count, 3), (count, 4), (count,), (count, colors), (count, 2))
    out = [empty_aligned(shape, np.float32) for shape in shapes]
    pool.run(
        spread_gradients,
        [(*r, rows.index, rows.values, rows.image, *out) for r in _ranges(rows.pieces, rows.index, count)],
    )
    return out


def dense_projected(projected, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Radii (N,) and image means (N, 2) of all Gaussians; 0 for those that were not projected."""
    out = empty_aligned((count,), np.int32), empty_aligned((count, 2), np.float32)
    lists = (projected.index, projected.radii, projected.means2d, *out)
    pool.run(spread_projected, [(*r, *lists) for r in _ranges(projected.seen, projected.index, count)])
    return out
