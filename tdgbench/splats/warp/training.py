"""What a training needs besides rendering: a step of Adam for all rows and columns, density control's statistics."""

import torch
import warp as wp
from torch import Tensor

from tdgbench.splats.gradients import (
    BETA1,
    BETA2,
    EPS,
    BadColumns,
    Gradients,
    GradientStatistics,
    RowSteps,
    flags_on_host,
)
from tdgbench.splats.warp.arrays import array, launch, on_stream

wp.set_module_options({"enable_backward": False})


@wp.struct
class Betas:
    """Decay of the moments and its complement, each rounded once from float64; eps."""

    first: float
    rest1: float
    second: float
    rest2: float
    eps: float


@wp.kernel
def step_values(
    gradients: wp.array2d(dtype=float), columns: wp.array2d(dtype=float), betas: Betas, values: wp.array2d(dtype=float),
    first: wp.array2d(dtype=float), second: wp.array2d(dtype=float), bad: wp.array(dtype=int),
):  # fmt: skip
    """Step values and moments (N, columns); bad (columns,) becomes 1 where a gradient is not finite."""
    i, j = wp.tid()
    g = gradients[i, j]
    if not wp.isfinite(g):
        bad[j] = 1
    m = first[i, j] * betas.first + g * betas.rest1
    v = second[i, j] * betas.second + g * g * betas.rest2
    first[i, j] = m
    second[i, j] = v
    values[i, j] = values[i, j] - columns[0, j] * m / (wp.sqrt(v) / columns[1, j] + betas.eps)


class WarpSteps(RowSteps):
    """Steps of float32 rows."""

    def _step_all(self, grad: Tensor, columns: Tensor) -> BadColumns:
        betas = Betas()
        betas.first, betas.second, betas.eps = BETA1, BETA2, EPS
        betas.rest1, betas.rest2 = 1 - BETA1, 1 - BETA2
        bad = torch.zeros(grad.shape[1], dtype=torch.int32, device=grad.device)
        rows = (self.state.values, self.state.first, self.state.second)
        with on_stream(grad.device):
            inputs = [array(grad), array(columns), betas, *map(array, rows), array(bad)]
            launch(step_values, grad.shape, inputs, grad)
        return flags_on_host(bad)


@wp.kernel
def count_visible(
    index: wp.array(dtype=int), radii: wp.array(dtype=int),
    view_counts: wp.array(dtype=float), max_radii: wp.array(dtype=float),
):  # fmt: skip
    """Count the view for the visible Gaussians (radius above zero) and update their largest radius, px.

    A Gaussian has at most one row in a view: no two threads write to the same place.
    """
    r = wp.tid()
    if radii[r] > 0:
        i = index[r]
        view_counts[i] = view_counts[i] + 1.0
        max_radii[i] = wp.max(max_radii[i], float(radii[r]))


@wp.kernel
def add_lengths(
    index: wp.array(dtype=int), image: wp.array2d(dtype=float), half: wp.vec2,
    grad_sum: wp.array(dtype=float), absolute_sum: wp.array(dtype=float),
):  # fmt: skip
    """Add the lengths of the image-plane gradients of the visible Gaussians, in units of `half`, px."""
    r = wp.tid()
    if image[r, 2] > 0.0:
        i = index[r]
        grad_sum[i] = grad_sum[i] + wp.length(wp.cw_mul(half, wp.vec2(image[r, 0], image[r, 1])))
        if absolute_sum.shape[0] > 0:
            absolute_sum[i] = absolute_sum[i] + wp.length(wp.cw_mul(half, wp.vec2(image[r, 3], image[r, 4])))


def observe_visible(view: Gradients, view_counts: Tensor, max_radii: Tensor) -> None:
    """Count a view for its visible Gaussians, and update their largest radii; both float32 (N,)."""
    with on_stream(view_counts.device):
        for first, count in view.projected_spans:
            rows = [array(t[first : first + count]) for t in (view.projected, view.radii)]
            launch(count_visible, count, [*rows, array(view_counts), array(max_radii)], view_counts)


def observe_gradients(view: Gradients, sums: GradientStatistics) -> None:
    """Add the lengths of a view's gradients to float32 sums."""
    half = wp.vec2(sums.half_width, sums.half_height)
    with on_stream(sums.grad_sum.device):
        for first, count in view.spans:
            rows = [array(t[first : first + count]) for t in (view.index, view.image)]
            launch(add_lengths, count, [*rows, half, *map(array, sums[:2])], sums.grad_sum)
