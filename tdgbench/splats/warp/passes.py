"""Forward and backward pass of a view for torch's autograd. The host waits once: for the number of pairs."""

import os
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from tdgbench.splats.warp.arrays import (
    TILE_PIXELS,
    Splats2D,
    TilePairs,
    WarpSource,
    WarpView,
    array,
    filled,
    launch,
    on_stream,
)
from tdgbench.splats.warp.blend import backward_blend, forward_blend
from tdgbench.splats.warp.gradient import add_pairs, project_backward
from tdgbench.splats.warp.projection import find_starts, list_pairs, project

LANES = tuple(str(2**power) for power in range(9))


class Request(NamedTuple):
    """A render. absgrad: (N, 2), to which the backward pass adds absolute gradients, or None."""

    view: WarpView
    depth: bool
    absgrad: Tensor | None


class WarpRasterize(torch.autograd.Function):
    """features (H, W, D, and 1 for depth), transmittance (H, W), radii (N,) px and depths (N,) of one camera.

    `probe` (N, 2) receives the image means; its gradient is d loss / d image mean, per px.
    """

    @staticmethod
    def forward(ctx, means, quats, scales, opacities, colors, probe, request: Request):
        gaussians = [t.detach() for t in (means, quats, scales, opacities, colors)]
        with on_stream(means.device):
            projected = _project(gaussians, request)
            pairs = _list_pairs(projected, request.view)
            light, transmittance, last = _blend(gaussians, projected, pairs, request)
        means2d, _, _, depths, radii, *_ = projected
        probe.data = means2d
        ctx.request, ctx.lanes = request, lanes_of(means.device)
        ctx.save_for_backward(*gaussians, *projected, *pairs, transmittance, last)
        ctx.mark_non_differentiable(radii, depths)
        return light, transmittance, radii, depths

    @staticmethod
    def backward(ctx, by_light, by_transmittance, *_):
        saved = iter(ctx.saved_tensors)
        gaussians, projected, pairs, images = ([next(saved) for _ in range(count)] for count in (5, 8, 3, 2))
        view, _, absgrad = ctx.request
        with on_stream(by_light.device):
            by_image = [by_light.contiguous(), by_transmittance.contiguous()]
            sums = _sum_over_pixels(gaussians[3], projected, pairs, [*images, *by_image], ctx.request, ctx.lanes)
            gradients = [torch.zeros_like(t, memory_format=torch.contiguous_format) for t in gaussians]
            inputs = [filled(WarpSource, gaussians), view, filled(Splats2D, projected), array(sums)]
            launch(project_backward, len(sums), [*inputs, filled(WarpSource, gradients)], sums)
        if absgrad is not None:
            absgrad += sums[:, -2:]
        return *gradients, sums[:, :2], None


def lanes_of(device: torch.device) -> int:
    """Return how many threads share a tile in the backward pass: on CUDA 256, with a block-wise reduction.

    TDGBENCH_WARP_LANES changes it, to one of `LANES`; 1 needs no reduction. Raises ValueError for another one.
    """
    asked = os.environ.get("TDGBENCH_WARP_LANES", LANES[-1] if device.type == "cuda" else LANES[0])
    if asked not in LANES:
        raise ValueError(f"TDGBENCH_WARP_LANES is {asked!r}; it must be one of {', '.join(LANES)}")
    return int(asked)


def count_pairs(ends: Tensor) -> int:
    """Return the last of the sums (N,), for which the host waits. Raises ValueError if it overflowed."""
    pairs = int(ends[-1]) if len(ends) else 0
    if pairs < 0:
        raise ValueError("more than 2³¹ pairs of a Gaussian and a tile; the Gaussians are too large for the image")
    return pairs


def _project(gaussians: list[Tensor], request: Request) -> list[Tensor]:
    """Return the tensors of `Splats2D`."""
    means, colors = gaussians[0], gaussians[4]
    count, features = len(means), colors.shape[2] + request.depth
    floats = [means.new_zeros(count, *shape) for shape in ((2,), (3,), (features,), ())]
    ints = [torch.zeros(shape, dtype=torch.int32, device=means.device) for shape in (count, (count, 4), count, 1)]
    projected = [*floats, *ints]
    launch(project, count, [filled(WarpSource, gaussians), request.view, filled(Splats2D, projected)], means)
    ends = array(projected[6])
    wp.utils.array_scan(ends, ends, inclusive=True)
    return projected


def _list_pairs(projected: list[Tensor], view: WarpView) -> list[Tensor]:
    """Return the tensors of `TilePairs`."""
    ends = projected[6]
    count = count_pairs(ends)
    keys = ends.new_empty(2 * count, dtype=torch.int64)  # the sort needs the second half
    pairs = [ends.new_empty(size) for size in (view.tiles_x * view.tiles_y + 1, 2 * count, count)]
    starts, slots, _ = pairs
    if count:
        launch(list_pairs, len(ends), [filled(Splats2D, projected), view, array(keys), filled(TilePairs, pairs)], ends)
        wp.utils.radix_sort_pairs(array(keys), array(slots), count, end_bit=32 + len(starts).bit_length())
    launch(find_starts, len(starts), [array(keys), count, array(starts)], ends)
    return pairs


def _blend(gaussians: list[Tensor], projected: list[Tensor], pairs: list[Tensor], request: Request) -> list[Tensor]:
    """Return features (H, W, F), transmittance (H, W) and each pixel's last pair (H, W)."""
    view, opacities, features = request.view, gaussians[3], projected[2].shape[1]
    size = (view.height, view.width)
    last = torch.empty(size, dtype=torch.int32, device=opacities.device)
    images = [opacities.new_empty(*size, features), opacities.new_empty(size), last]
    inputs = [view, filled(Splats2D, projected), filled(TilePairs, pairs), array(opacities), *map(array, images)]
    pixels = view.tiles_x * view.tiles_y * TILE_PIXELS
    launch(forward_blend(features), pixels, inputs, opacities, block_dim=TILE_PIXELS)
    return images


def _sum_over_pixels(
    opacities: Tensor, projected: list[Tensor], pairs: list[Tensor], images: list[Tensor], request: Request, lanes: int
) -> Tensor:
    """Return the gradients (N, columns) by what `project` computes; see `blend.GEOMETRY` for the columns.

    images: transmittance and last pair, then the gradients by features and transmittance. lanes: threads per tile.
    """
    view, ends, features = request.view, projected[6], projected[2].shape[1]
    blend = backward_blend(features, lanes, request.absgrad is not None)
    rows = opacities.new_zeros(len(pairs[2]), blend.columns)
    inputs = [view, filled(Splats2D, projected), filled(TilePairs, pairs), array(opacities), *map(array, images)]
    tiles, device = view.tiles_x * view.tiles_y, str(opacities.device)
    wp.launch_tiled(blend.kernel, dim=[tiles], inputs=[*inputs, array(rows, blend.row)], block_dim=lanes, device=device)
    sums = opacities.new_empty(len(ends), blend.columns)
    launch(add_pairs, sums.shape, [array(rows), array(ends), array(sums)], opacities)
    return sums
