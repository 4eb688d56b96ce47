"""The `cpu` backend: the Numba kernels behind torch's autograd."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu.raster.backward import backward
from tdgbench.splats.cpu.raster.camera import pack_camera
from tdgbench.splats.cpu.raster.dense import dense_gradients, dense_projected
from tdgbench.splats.cpu.raster.forward import forward
from tdgbench.splats.cpu.raster.limits import pack_limits
from tdgbench.splats.cpu.raster.source import Source, source_of_arrays
from tdgbench.splats.cpu.raster.types import Settings
from tdgbench.splats.view import RenderedView

MAX_CHANNELS = 4
MAX_SIDE = 32_767  # px


def check(channels: int, depth: bool, width: int, height: int) -> None:
    """Raise ValueError for what this backend cannot render."""
    if not 1 <= channels + depth <= MAX_CHANNELS:
        raise ValueError(
            f"backend cpu blends 1 to {MAX_CHANNELS} channels (depth is one); {channels} colours"
            f"{' and depth' if depth else ''} were asked for: render them in turns"
        )
    if max(width, height) > MAX_SIDE:
        raise ValueError(f"backend cpu renders up to {MAX_SIDE} px a side; {width}×{height} was asked for")


def _arrays(tensors) -> list[np.ndarray | None]:
    return [None if tensor is None else tensor.detach().contiguous().numpy() for tensor in tensors]


def _tensors(arrays) -> list[Tensor]:
    return [torch.from_numpy(array) for array in arrays]


class Rasterize(torch.autograd.Function):
    """color (H, W, D), depth (H, W; empty if not asked for), transmittance (H, W) and radii (N,) of one camera.

    `probe` (N, 2) receives the image means; its gradient is d loss / d image mean, per px.
    """

    @staticmethod
    def forward(ctx, means, quats, scales, opacities, colors, probe, settings):
        source = source_of_arrays(_arrays((means, quats, scales, opacities, colors)))
        done = forward(source, settings)
        radii, probe.data = _tensors(dense_projected(done.projected, done.projected_spans, source.count))
        ctx.saved = (source, settings, done, colors.shape)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(radii)
        return (*_tensors(done.images), radii)

    @staticmethod
    def backward(ctx, grad_color, grad_depth, grad_transmittance, _grad_radii):
        source, settings, done, color_shape = ctx.saved
        rows = backward(source, settings, done, *_arrays((grad_color, grad_depth, grad_transmittance)))
        dense = dense_gradients(rows, source.count, int(np.prod(color_shape[1:])))
        means, quats, scales, opacities, colors, means2d = _tensors(dense)
        return means, quats, scales, opacities, colors.view(color_shape), means2d, None


def rasterize(means, quats, scales, opacities, colors, viewmat, K, width, height, *, near_plane, far_plane,
              eps2d, sh_degree, background, depth_channel, blending) -> RenderedView:  # fmt: skip
    """Render one camera; what `tdgbench.splats.backends.reference.rasterize` does, fast."""
    if colors.dim() == 2:
        colors = colors[:, None, :]
    n_colors = colors.shape[-1]
    check(n_colors, depth_channel, width, height)
    black = np.zeros(n_colors, np.float32)
    settings = Settings(
        camera=pack_camera(viewmat.detach(), K.detach(), width, height, near_plane, far_plane, eps2d),
        width=width,
        height=height,
        degree=-1 if sh_degree is None else sh_degree,
        depth_channel=depth_channel,
        background=black if background is None else background.detach().contiguous().numpy(),
        limits=pack_limits(blending),
    )
    probe = torch.empty(len(means), 2, requires_grad=torch.is_grad_enabled() and means.requires_grad)
    image, depth, transmittance, radii = Rasterize.apply(means, quats, scales, opacities, colors, probe, settings)
    depths = means.detach() @ viewmat[2, :3].to(means) + viewmat[2, 3].to(means)
    return RenderedView(image, depth if depth_channel else None, transmittance, probe, depths, radii)


class _RenderRows(torch.autograd.Function):
    """`Rasterize` for Gaussians whose gradients do not pass through torch: `deliver` gets them."""

    @staticmethod
    def forward(ctx, trigger, source, settings, deliver):
        done = forward(source, settings)
        ctx.saved = (source, settings, done, deliver)
        ctx.set_materialize_grads(False)
        return tuple(_tensors(done.images))

    @staticmethod
    def backward(ctx, *grads):
        source, settings, done, deliver = ctx.saved
        deliver(backward(source, settings, done, *_arrays(grads)), done)
        return None, None, None, None


def render_rows(source: Source, settings: Settings, deliver) -> tuple[Tensor, Tensor, Tensor]:
    """Image (H, W, D), depth (H, W; empty if not asked for) and transmittance (H, W).

    The backward pass calls deliver(GradientRows, ForwardPass).
    """
    check(len(settings.background), settings.depth_channel, settings.width, settings.height)
    trigger = torch.zeros((), requires_grad=torch.is_grad_enabled())
    return _RenderRows.apply(trigger, source, settings, deliver)
