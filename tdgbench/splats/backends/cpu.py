"""The `cpu` backend: the Numba kernels behind torch's autograd."""

from __future__ import annotations

from contextlib import AbstractContextManager

import numpy as np
import torch

from tdgbench.splats.backends.backend import Backend, Collect, StateOptions
from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu.precompile import compiled_alongside
from tdgbench.splats.cpu.raster.dense import dense_gradients, dense_projected
from tdgbench.splats.cpu.raster.limits import pack_limits
from tdgbench.splats.cpu.raster.passes import ForwardPass, GradientRows, Settings, Source, backward, forward
from tdgbench.splats.cpu.raster.projection import CAMERA_SIZE
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam, Tolerance
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import GaussianTensors, Pinhole, Projection, Render, RenderOptions

MAX_CHANNELS = 4
MAX_SIDE = 32_767
EVERYWHERE = Tolerance(mean=1e30, log_scale=0.0)  # culls nothing


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


def _arrays_of(tensors) -> Source:
    """A source that reads tensors (N, …) as they are."""
    arrays = tuple(t.detach().contiguous().numpy().reshape(-1) for t in tensors)
    strides = [t[0].numel() if len(t) else 1 for t in tensors]
    layout = np.array([n for stride in strides for n in (stride, 0)], np.int64)
    return Source(len(tensors[0]), arrays, layout, False, (arrays[1], 3, 0, 3), (arrays[0], 3, 0))


class Rasterize(torch.autograd.Function):
    """image (H, W, D), depth (H, W; empty if not asked for), transmittance (H, W) and radii (N,) of one camera.

    `probe` (N, 2) receives the image means; its gradient is d loss / d image mean, in pixels.
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
        source, settings, done, _probe, color_shape = ctx.saved
        grads = (None if g is None else g.numpy() for g in (grad_image, grad_depth, grad_transmittance))
        rows = backward(source, settings, done, *grads)
        per_color = int(np.prod(color_shape[1:]))
        dense = (torch.from_numpy(a) for a in dense_gradients(rows, source.count, per_color))
        means, scales, quats, opacities, colors, means2d = dense
        return means, quats, scales, opacities, colors.view(color_shape), means2d, None


class _RenderRows(torch.autograd.Function):
    """Like `Rasterize`, for Gaussians whose gradients do not go through torch: they are passed to `deliver`."""

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


class CpuBackend(Backend):
    """Float32 on the CPU. States in training are rendered without autograd: gradients and steps of some rows only."""

    inputs = "float32 tensors on the CPU"

    def takes(self, device: torch.device, dtype: torch.dtype) -> bool:
        return device.type == "cpu" and dtype == torch.float32

    def compiling(self, channels: set[int]) -> AbstractContextManager[None]:
        return compiled_alongside(channels)

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        means, quats, scales, opacities, colors, sh_degree = gaussians
        if colors.dim() == 2:
            colors = colors[:, None, :]
        settings = _settings(camera, colors.shape[-1], -1 if sh_degree is None else sh_degree, options)
        probe = torch.empty(len(means), 2, requires_grad=torch.is_grad_enabled() and means.requires_grad)
        image, depth, transmittance, radii = Rasterize.apply(means, quats, scales, opacities, colors, probe, settings)
        depths = means.detach() @ camera.viewmat[2, :3].to(means) + camera.viewmat[2, 3].to(means)
        return Render(image, depth if options.depth else None, transmittance, Projection(probe, radii, depths))

    def render_state(
        self, state: TrainingState, optimizer: Adam, camera: Pinhole, options: StateOptions, collect: Collect
    ) -> Render:
        source = _rows_of(state, optimizer, options.tolerance or EVERYWHERE)
        view = RenderOptions(options.depth, blending=options.blending)
        settings = _settings(camera, state.channels, options.sh_degree, view)

        def deliver(rows, done) -> None:
            collect(_gradients(rows, done))

        trigger = torch.zeros((), requires_grad=torch.is_grad_enabled())
        image, depth, transmittance = _RenderRows.apply(trigger, source, settings, deliver)
        return Render(image, depth if options.depth else None, transmittance)


def check(channels: int, depth: bool, width: int, height: int) -> None:
    """Raise ValueError for a view that this backend cannot render."""
    if not 1 <= channels + depth <= MAX_CHANNELS:
        raise ValueError(
            f"backend cpu blends 1 to {MAX_CHANNELS} channels, and depth is one; {channels} colours"
            f"{' and depth' if depth else ''} were requested: render them one after the other"
        )
    if max(width, height) > MAX_SIDE:
        raise ValueError(f"backend cpu renders up to {MAX_SIDE} px a side; {width}×{height} was requested")


def _settings(camera: Pinhole, channels: int, degree: int, options: RenderOptions) -> Settings:
    """Kernel settings of a view. Raises ValueError if this backend cannot render it."""
    check(channels, options.depth, camera.width, camera.height)
    background = options.background
    black = np.zeros(channels, np.float32)
    return Settings(
        camera=pack_camera(camera.viewmat.detach(), camera.K.detach(), *camera[2:]),
        width=camera.width,
        height=camera.height,
        degree=degree,
        depth_channel=options.depth,
        background=black if background is None else background.detach().contiguous().numpy(),
        limits=pack_limits(options.blending),
    )


def _rows_of(state: TrainingState, optimizer: Adam, tolerance: Tolerance) -> Source:
    """A source that reads the rows of a state in training, and updates those that culling lets through."""
    values = state.values.numpy().reshape(-1)
    stride = state.values.shape[1]
    columns = (MEANS_AT, SCALES_AT, QUATS_AT, OPACITY_AT, COLORS_AT)
    layout = np.array([n for column in columns for n in (stride, column)], np.int64)
    bounds = state.bounds.numpy().reshape(-1)
    return Source(
        len(state), (values,) * 5, layout, True, (bounds, 4, 3, 1), (bounds, 4, 0), *tolerance, optimizer.update_rows
    )


def _gradients(rows: GradientRows, done: ForwardPass) -> Gradients:
    """The rows of a backward pass as tensors, without copying."""
    index, values, image = (torch.from_numpy(a) for a in (rows.index, rows.values, rows.image))
    projected, radii = torch.from_numpy(done.projected.index), torch.from_numpy(done.projected.radii)
    return Gradients(
        rows.pieces, index, values, image, done.projected.seen, projected, radii,
        pairs=done.count_pairs(), blended=int(done.reached.sum()), lease=(rows.lease, done.lease),
    )  # fmt: skip


BACKEND = CpuBackend()
