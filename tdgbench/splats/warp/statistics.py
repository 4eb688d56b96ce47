"""Density control's statistics of a view, as in `tdgbench.splats.cpu.statistics`.

A Gaussian has at most one row in a view: no two threads write to the same place.
"""

import warp as wp
from torch import Tensor

from tdgbench.splats.gradients import Gradients, GradientStatistics
from tdgbench.splats.warp.arrays import array, on_stream
from tdgbench.splats.warp.passes import launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def count_visible(
    index: wp.array(dtype=int), radii: wp.array(dtype=int),
    view_counts: wp.array(dtype=float), max_radii: wp.array(dtype=float),
):  # fmt: skip
    """Count the view for the visible Gaussians (radius above zero) and update their largest radius, px."""
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
