"""The `cpu` backend: the Numba kernels behind torch's autograd."""

from __future__ import annotations

import numpy as np
import torch

from tdgbench.splats.cpu.raster.dense import dense_gradients, dense_projected
from tdgbench.splats.cpu.raster.limits import pack_limits
from tdgbench.splats.cpu.raster.passes import Settings, Source, backward, forward
from tdgbench.splats.cpu.raster.projection import CAMERA_SIZE
from tdgbench.splats.view import RenderedView

MAX_CHANNELS = 4
MAX_SIDE = 32_767


def pack_camera(viewmat, K, width, height, near_plane, far_plane, eps2d) -> np.ndarray:
    """The camera as the float32 array that the kernels read."""
    view = np.asarray(viewmat, np.float64)
    K = np.asarray(K, np.float64)
    packed = np.zeros(CAMERA_SIZE, np.float32)
    packed[0:12] = view[:3].reshape(-1)
    packed[12:16] = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    centre = np.linalg.solve(view[:3, :3], -view[:3, 3])
    packed[16:19] = centre
    packed[24:27] = centre - packed[16:19]
    packed[19:24] = near_plane, far_plane, eps2d, width, height
    return packed


def check(channels: int, depth: bool, width: int, height: int) -> None:
    """Raise ValueError for what this backend cannot render."""
    if not 1 <= channels + depth <= MAX_CHANNELS:
        raise ValueError(
            f"backend cpu blends 1 to {MAX_CHANNELS} channels (depth is one); {channels} colours"
            f"{' and depth' if depth else ''} were asked for: render them in turns"
        )
    if max(width, height) > MAX_SIDE:
        raise ValueError(f"backend cpu renders up to {MAX_SIDE} px a side; {width}×{height} was asked for")


def _arrays_of(tensors) -> Source:
    """A source that reads tensors (N, …) as they are."""
    arrays = tuple(t.detach().contiguous().numpy().reshape(-1) for t in tensors)
    strides = [t[0].numel() if len(t) else 1 for t in tensors]
    layout = np.array([n for stride in strides for n in (stride, 0)], np.int64)
    return Source(len(tensors[0]), arrays, layout, False, (arrays[1], 3, 0, 3), (arrays[0], 3, 0))


class Rasterize(torch.autograd.Function):
    """image (H, W, D), depth (H, W; empty if not asked for), transmittance (H, W) and radii (N,) of one camera.

    `probe` (N, 2) is given the image means; its gradient is d loss / d image mean, in pixels.
    """

    @staticmethod
    def forward(ctx, means, quats, scales, opacities, colors, probe, settings):
        source = _arrays_of((means, scales, quats, opacities, colors))
        done = forward(source, settings)
        radii, means2d = (torch.from_numpy(a) for a in dense_projected(done.projected, source.count))
        probe.data = means2d
        ctx.saved = (source, settings, done, probe, colors.shape)
        ctx.set_materialize_grads(False)
        outputs = (*(torch.from_numpy(a) for a in (done.image, done.depth, done.transmittance)), radii)
        ctx.mark_non_differentiable(radii)
        return outputs

    @staticmethod
    def backward(ctx, grad_image, grad_depth, grad_transmittance, _grad_radii):
        source, settings, done, probe, color_shape = ctx.saved
        grads = (None if g is None else g.numpy() for g in (grad_image, grad_depth, grad_transmittance))
        rows = backward(source, settings, done, *grads)
        per_color = int(np.prod(color_shape[1:]))
        dense = (torch.from_numpy(a) for a in dense_gradients(rows, source.count, per_color))
        means, scales, quats, opacities, colors, means2d = dense
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
    """Like `Rasterize`, for Gaussians whose gradients do not go through torch: they are handed to `deliver`."""

    @staticmethod
    def forward(ctx, trigger, source, settings, deliver):
        done = forward(source, settings)
        ctx.saved = (source, settings, done, deliver)
        ctx.set_materialize_grads(False)
        return tuple(torch.from_numpy(a) for a in (done.image, done.depth, done.transmittance))

    @staticmethod
    def backward(ctx, *grads):
        source, settings, done, deliver = ctx.saved
        rows = backward(source, settings, done, *(None if g is None else g.numpy() for g in grads))
        deliver(rows, done)
        return None, None, None, None


def render_rows(source: Source, settings: Settings, deliver) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """image, depth (empty if not asked for) and transmittance; backward calls deliver(GradientRows, ForwardPass)."""
    check(len(settings.background), settings.depth_channel, settings.width, settings.height)
    trigger = torch.zeros((), requires_grad=torch.is_grad_enabled())
    return _RenderRows.apply(trigger, source, settings, deliver)
