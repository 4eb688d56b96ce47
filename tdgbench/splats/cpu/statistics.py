"""Statistics of a view for density control: visible Gaussians, their radii, their image-plane gradients."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from torch import Tensor

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.gradients import Gradients, GradientStatistics, PendingGradients

U = np.uint64


@kernel()
def count_visible(first, count, index, radii, view_counts, max_radii):
    """Count the view for the visible Gaussians (radius above zero) and update their largest radius.

    index, radii: int32 (capacity,), of which [first, first + count) is read; view_counts, max_radii (px): float32 (N,).
    """
    for r in range(U(first), U(first + count)):
        if radii[r] > 0:
            i = U(index[r])
            view_counts[i] += np.float32(1)
            max_radii[i] = max(max_radii[i], np.float32(radii[r]))


EMPTY = np.empty(0, np.float32)


class StatisticsArrays(NamedTuple):
    """`GradientStatistics` as kernels take them; inactive: nothing is accumulated."""

    grad_sum: np.ndarray  # float32 (N,)
    half_width: float  # px
    half_height: float
    active: bool
    absolute_sum: np.ndarray = EMPTY  # float32 (N,), or empty

    @classmethod
    def of(cls, statistics: GradientStatistics | None) -> StatisticsArrays:
        """Return the arrays that share memory with float32 tensors on the CPU."""
        if statistics is None:
            return NO_STATISTICS
        grad_sum, absolute_sum, half_width, half_height = statistics
        return cls(grad_sum.numpy(), half_width, half_height, True, absolute_sum.numpy())


NO_STATISTICS = StatisticsArrays(EMPTY, 0.0, 0.0, False)


@kernel(inline=True)
def add_length(statistics, total, i, gu, gv):
    """Add the length of an image-plane gradient (per px) to total[i], a sum of the statistics."""
    gu, gv = gu * statistics.half_width, gv * statistics.half_height
    total[i] += math.sqrt(gu * gu + gv * gv)


@kernel()
def add_lengths(first, count, index, image, statistics):
    """Add the length of the image-plane gradient of the visible Gaussians; statistics: StatisticsArrays.

    index: int32 (capacity,); image: float32 (capacity, 3 or 5), see `Gradients.image`; of both [first, first + count)
    is read.
    """
    for r in range(U(first), U(first + count)):
        if image[r, U(2)] > np.float32(0):
            add_length(statistics, statistics.grad_sum, U(index[r]), image[r, U(0)], image[r, U(1)])
            if statistics.absolute_sum.size > 0:
                add_length(statistics, statistics.absolute_sum, U(index[r]), image[r, U(3)], image[r, U(4)])


def observe_visible(view: Gradients | PendingGradients, view_counts: Tensor, max_radii: Tensor) -> None:
    """Count a view for its visible Gaussians, and update their largest radii; both float32 (N,)."""
    rows = (view.projected.numpy(), view.radii.numpy(), view_counts.numpy(), max_radii.numpy())
    items = sum(count for _, count in view.projected_spans)
    pool.run(count_visible, [(*span, *rows) for span in view.projected_spans], items=items, each=pool.ROWS_EACH)


def observe_gradients(gradients: Gradients, statistics: StatisticsArrays) -> None:
    """Add the image-plane gradients of float32 rows to the statistics."""
    rows = (gradients.index.numpy(), gradients.image.numpy(), statistics)
    calls = [(*span, *rows) for span in gradients.spans]
    pool.run(add_lengths, calls, items=gradients.touched, each=pool.ROWS_EACH)
