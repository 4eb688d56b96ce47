"""Statistics of a view for density control: visible Gaussians, their radii, their image-plane gradients."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu.jit import kernel

U = np.uint64


@kernel()
def observe_visible(first, count, index, radii, view_counts, max_radii):
    """Count the view for the visible Gaussians (radius above zero) and update their largest radius.

    index, radii: int32 (capacity,), of which [first, first + count) is read; view_counts, max_radii (px): float32 (N,).
    """
    for r in range(U(first), U(first + count)):
        if radii[r] > 0:
            i = U(index[r])
            view_counts[i] += np.float32(1)
            max_radii[i] = max(max_radii[i], np.float32(radii[r]))


EMPTY = np.empty(0, np.float32)


class GradientStatistics(NamedTuple):
    """Where density control accumulates the gradients of a view in its image."""

    grad_sum: np.ndarray  # float32 (N,): in units of half the image
    half_width: float  # of the image, px
    half_height: float
    active: bool
    absolute_sum: np.ndarray = EMPTY  # float32 (N,): the same of absolute gradients; empty: not accumulated


NO_STATISTICS = GradientStatistics(EMPTY, 0.0, 0.0, False)


@kernel(inline=True)
def add_length(statistics, total, i, gu, gv):
    """Add the length of an image-plane gradient (per px) to total[i], a sum of the statistics."""
    gu, gv = gu * statistics.half_width, gv * statistics.half_height
    total[i] += math.sqrt(gu * gu + gv * gv)


@kernel()
def observe_gradients(first, count, index, image, statistics):
    """Add the length of the image-plane gradient of the visible Gaussians; statistics: GradientStatistics.

    index: int32 (capacity,); image: float32 (capacity, 3 or 5), see `Gradients.image`; of both [first, first + count)
    is read.
    """
    for r in range(U(first), U(first + count)):
        if image[r, U(2)] > np.float32(0):
            add_length(statistics, statistics.grad_sum, U(index[r]), image[r, U(0)], image[r, U(1)])
            if statistics.absolute_sum.size > 0:
                add_length(statistics, statistics.absolute_sum, U(index[r]), image[r, U(3)], image[r, U(4)])
