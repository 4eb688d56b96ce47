"""Render Gaussians in training, so that gradients come back as rows: through autograd, or past it on the CPU."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.backends.cpu import pack_camera, render_rows
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.cpu.raster.limits import pack_limits
from tdgbench.splats.cpu.raster.source import source_of_rows
from tdgbench.splats.cpu.raster.types import Settings
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.rasterization import EPS2D, FAR_PLANE, NEAR_PLANE, choose_backend, render_view
from tdgbench.splats.state import TrainingState

Collect = Callable[[Gradients], None]
EVERYWHERE = 1e30  # a slack that nothing is out of sight with


def render_state(
    state: TrainingState,
    optimizer: Adam,
    viewmat: np.ndarray,
    K: np.ndarray,
    width: int,
    height: int,
    *,
    degree: int,
    depth: bool,
    iteration: int,
    backend: str,
    collect: Collect,
    blending: Blending = AS_3DGS,
    skip_unseen: bool = True,
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Image (H, W, C), depth (H, W) or None, transmittance (H, W), before black, as `render_view` gives them.

    The backward pass calls collect(Gradients) once it is through. viewmat (4, 4), K (3, 3). skip_unseen: Gaussians
    that four numbers show to be out of sight are not projected.
    """
    like = state.values
    if choose_backend(backend, like.device, like.dtype) == "cpu":
        return _past_autograd(state, optimizer, viewmat, K, width, height, degree, depth, iteration, collect, blending,
                              skip_unseen)  # fmt: skip
    optimizer.settle()
    rows = like.detach()
    if torch.is_grad_enabled():
        rows = rows.requires_grad_()
    gaussians = state.split(rows)
    view = render_view(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh,
        torch.as_tensor(viewmat).to(like), torch.as_tensor(K).to(like), width, height,
        sh_degree=degree, depth=depth, backend=backend, blending=blending,
    )  # fmt: skip
    if rows.requires_grad:
        rows.register_hook(lambda grad: collect(_dense(grad, view)))
    return view.image, view.depth, view.transmittance


def _dense(grad, view) -> Gradients:
    assert view.means2d.grad is not None
    return Gradients.dense(grad, view.means2d.grad, view.radii)


def _past_autograd(state, optimizer, viewmat, K, width, height, degree, depth, iteration, collect, blending,
                   skip_unseen):  # fmt: skip
    slack, growth = optimizer.slack(iteration) if skip_unseen else (EVERYWHERE, 0.0)
    source = source_of_rows(state.values.numpy(), state.bounds.numpy(), slack, growth, optimizer.catch_up)
    settings = Settings(
        camera=pack_camera(viewmat, K, width, height, NEAR_PLANE, FAR_PLANE, EPS2D),
        width=width,
        height=height,
        degree=degree,
        depth_channel=depth,
        background=np.zeros(state.channels, np.float32),
        limits=pack_limits(blending),
    )

    def deliver(rows, done) -> None:
        index, values, image = (torch.from_numpy(a) for a in rows.arrays)
        seen, radii = torch.from_numpy(done.projected.gaussian_ids), torch.from_numpy(done.projected.radii)
        owner = (rows.workspace, done.workspace)
        work = done.count_pairs(), int(done.visits.counts.sum())
        collect(Gradients(rows.spans, index, values, image, done.projected_spans, seen, radii, *work, owner))

    image, depth_map, transmittance = render_rows(source, settings, deliver)
    return image, depth_map if depth else None, transmittance
