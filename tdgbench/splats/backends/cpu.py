"""The `cpu` backend: the Numba kernels behind torch's autograd."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.backends.backend import Backend, Collect, StateOptions, SumFootprints
from tdgbench.splats.cpu import statistics
from tdgbench.splats.cpu.adam import DeferredSteps
from tdgbench.splats.cpu.losses import minmax
from tdgbench.splats.cpu.losses.photometric import image_loss
from tdgbench.splats.cpu.precompile import compiled_alongside
from tdgbench.splats.cpu.raster.dense import of_rows
from tdgbench.splats.cpu.raster.passes import blend_backward, forward
from tdgbench.splats.cpu.raster.projection import GATHERED
from tdgbench.splats.cpu.raster.types import (
    MAX_CHANNELS,
    Channels,
    Columns,
    Settings,
    Span,
    pack_camera,
    pack_limits,
    plain_channels,
    source_of_arrays,
    source_of_rows,
)
from tdgbench.splats.cpu.scratch import empty_rows, free_buffers
from tdgbench.splats.gaussians import COLORS_AT, GEOMETRY_SIZES, RenderedFields
from tdgbench.splats.gradients import Gradients, GradientStatistics, Rows, RowSteps, Tolerance
from tdgbench.splats.harmonics import num_bases
from tdgbench.splats.view import GaussianTensors, Pinhole, Projection, Render, RenderOptions

MAX_SIDE = 32_767  # px
EVERYWHERE = Tolerance(mean=1e30, log_scale=0.0)  # culls nothing
_TRIGGER = torch.zeros((), requires_grad=True)  # has torch call the backward pass of `_RenderRows`; it gets no gradient


def _arrays(tensors) -> list[np.ndarray | None]:
    return [None if tensor is None else tensor.detach().contiguous().numpy() for tensor in tensors]


def _tensors(arrays) -> list[Tensor]:
    return [torch.from_numpy(array) for array in arrays]


def _dense(rows, gaussian_ids, spans: list[Span], count: int, width: int) -> Tensor:
    return torch.from_numpy(of_rows(np.asarray(rows), np.asarray(gaussian_ids), spans, count, [width])[0])


class Rasterize(torch.autograd.Function):
    """color (H, W, D), depth (H, W; empty if not asked for), transmittance (H, W) and radii (N,) of one camera.

    `probe` (N, 2) receives the image means; its gradient is d loss / d image mean, per px. `absgrad` (N, 2) or None:
    the backward pass adds the absolute gradients.
    """

    @staticmethod
    def forward(ctx, means, quats, scales, opacities, colors, probe, absgrad, settings):
        source = source_of_arrays(_arrays((means, quats, scales, opacities, colors)))
        view = forward(source, settings)
        ids, radii, means2d = view.projected
        to_all = (ids, view.projected_spans, source.count)
        radii, probe.data = _dense(radii[:, None], *to_all, 1).squeeze(1), _dense(means2d, *to_all, 2)
        ctx.saved = (source, settings, view, colors.shape, absgrad)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(radii)
        return (*_tensors(view.images), radii)

    @staticmethod
    def backward(ctx, grad_color, grad_depth, grad_transmittance, _grad_radii):
        source, settings, view, color_shape, absgrad = ctx.saved
        found = blend_backward(source, settings, view, *_arrays((grad_color, grad_depth, grad_transmittance))).compute()
        at, widths = (found.index.numpy(), found.spans, source.count), [*GEOMETRY_SIZES, math.prod(color_shape[1:])]
        *geometry, opacities, colors = _tensors(of_rows(found.values.numpy(), *at, widths))
        if absgrad is not None:
            absgrad += _dense(found.image[:, 3:], *at, 2)
        return *geometry, opacities.squeeze(1), colors.reshape(color_shape), _dense(found.image, *at, 2), None, None


class _RenderRows(torch.autograd.Function):
    """`Rasterize` for Gaussians whose gradients do not pass through torch: `deliver` gets a `Blended`."""

    @staticmethod
    def forward(ctx, trigger, source, settings, deliver):
        view = forward(source, settings)
        ctx.saved = (source, settings, view, deliver)
        ctx.set_materialize_grads(False)
        return tuple(_tensors(view.images))

    @staticmethod
    def backward(ctx, *grads):
        (source, settings, view, deliver), ctx.saved = ctx.saved, None  # the loss, and so this, outlives the step
        deliver(blend_backward(source, settings, view, *_arrays(grads)))
        return None, None, None, None


class CpuBackend(Backend):
    """Float32 on the CPU. States in training are rendered without autograd: gradients and steps of some rows only."""

    inputs = "float32 tensors on the CPU"
    devices = ("cpu",)
    capacity_growth = 3.0  # memory that was never written costs nothing

    def compiling(self, channels: set[int], depth: bool) -> AbstractContextManager[None]:
        return compiled_alongside(channels, depth)

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        means, quats, scales, opacities, colors, sh_degree = gaussians
        if colors.dim() == 2:
            colors = colors[:, None, :]
        degree = -1 if sh_degree is None else sh_degree
        probe = torch.empty(len(means), 2, requires_grad=torch.is_grad_enabled() and means.requires_grad)
        absgrad = torch.zeros(len(means), 2) if options.absgrad else None
        images = []
        for part, of_pass in _passes(colors.shape[-1], options):
            blended = plain_channels(part.stop - part.start, degree, of_pass.depth, of_pass.absgrad)
            settings = _settings(camera, blended, of_pass)
            parameters = (means, quats, scales, opacities, colors[..., part].contiguous())
            image, depth, transmittance, radii = Rasterize.apply(*parameters, probe, absgrad, settings)
            images.append(image)
        image = images[0] if len(images) == 1 else torch.cat(images, dim=-1)
        depths = means.detach() @ camera.viewmat[2, :3].to(means) + camera.viewmat[2, 3].to(means)
        return Render(image, depth if options.depth else None, transmittance, Projection(probe, radii, depths, absgrad))

    def footprint_sums(self, gaussians: GaussianTensors, channels: int) -> SumFootprints:
        if channels > MAX_CHANNELS:
            return super().footprint_sums(gaussians, channels)
        count = len(gaussians.means)
        source = source_of_arrays(
            [*(t.detach().contiguous().numpy() for t in gaussians[:4]), np.zeros((count, channels), np.float32)]
        )

        def sums(camera: Pinhole, maps: Tensor) -> tuple[Tensor, Tensor]:
            if maps.shape != (camera.height, camera.width, channels):
                raise ValueError(f"maps of {channels} channels were announced; these are {tuple(maps.shape)}")
            settings = _settings(camera, plain_channels(channels, -1, depth=False), RenderOptions())
            view = forward(source, settings)
            found = blend_backward(source, settings, view, *_arrays((maps, None, None))).compute()
            colors = _dense(found.values[:, COLORS_AT:], found.index, found.spans, count, channels)
            return colors, found.all_radii(count)

        return sums

    def render_state(
        self, state: Rows, steps: RowSteps, camera: Pinhole, options: StateOptions, collect: Collect
    ) -> Render:
        channels = _channels(state, options)
        if channels is None or camera.viewmat.requires_grad:
            return super().render_state(state, steps, camera.to(state.values), options, collect)
        assert isinstance(steps, DeferredSteps)
        tolerance = options.tolerance or EVERYWHERE
        rows = state.arrays()
        source = source_of_rows(rows.values, rows.bounds, *tolerance, steps.stale())
        settings = _settings(camera, channels, options.of_view)
        image, depth, transmittance = _RenderRows.apply(_TRIGGER, source, settings, collect)
        return Render(image, depth if options.depth else None, transmittance)

    def new_rows(self, like: Tensor, shape: tuple[int, int], zeros: bool = False) -> Tensor:
        if like.dtype != torch.float32:  # of clocks
            return super().new_rows(like, shape, zeros)
        return torch.from_numpy(empty_rows(*shape, zeros=zeros))

    def steps_of(self, state: Rows) -> RowSteps:
        return DeferredSteps(state)

    def observe_gradients(self, gradients: Gradients, sums: GradientStatistics) -> None:
        statistics.observe_gradients(gradients, statistics.StatisticsArrays.of(sums))

    free_memory = staticmethod(free_buffers)
    observe_visible = staticmethod(statistics.observe_visible)
    image_loss = staticmethod(image_loss)
    min_max = staticmethod(minmax.min_max)
    inverse_expected_depth = staticmethod(minmax.inverse_expected_depth)


def _passes(channels: int, options: RenderOptions) -> Iterator[tuple[slice, RenderOptions]]:
    """Yield the channels that each pass blends, and its options; depth, a channel too, is in the last pass."""
    firsts = [*range(0, channels, MAX_CHANNELS)] or [0]
    if options.absgrad and channels + options.depth > MAX_CHANNELS:
        asked = f"{channels} channels{' and depth' * options.depth}"
        raise ValueError(
            f"backend cpu gives absolute gradients of up to {MAX_CHANNELS} channels, and {asked} were requested; "
            "use backend=reference or budget.density.gradient=signed"
        )
    if options.depth and channels == firsts[-1] + MAX_CHANNELS:
        firsts.append(channels)
    for first in firsts:
        part = slice(first, min(first + MAX_CHANNELS, channels))
        behind = None if options.background is None else options.background[part]
        yield part, RenderOptions(options.depth and first == firsts[-1], behind, options.blending, options.absgrad)


def _channels(state: Rows, options: StateOptions) -> Channels | None:
    """Return what is rendered of the rows of a state; None if the kernels cannot."""
    hook = RenderedFields() if options.hook is None else options.hook
    if not isinstance(hook, RenderedFields) or len(hook.colors) > 2 or hook.colors[0] in hook.colors[1:]:
        return None
    sets = [(state.columns_of(name), state.channels_of(name)) for name in hook.colors]
    opacity, bases = state.columns_of(hook.opacity), num_bases(options.sh_degree)
    ends = [at.start + bases * count for at, count in sets]
    used, colors = max(opacity.stop, *ends), sum(count for _, count in sets)
    has_all = opacity.stop == opacity.start + 1 and all(end <= at.stop for end, (at, _) in zip(ends, sets, strict=True))
    if not has_all or used > GATHERED or colors + options.depth > MAX_CHANNELS:
        return None
    columns = Columns(opacity.start, sets[0][0].start, sets[-1][0].start, sets[0][1], used)
    return Channels(colors, options.sh_degree, options.depth, columns, options.absgrad)


def _settings(camera: Pinhole, channels: Channels, options: RenderOptions) -> Settings:
    """Return the kernel settings of a view. Raises ValueError if this backend cannot render it."""
    if max(camera.width, camera.height) > MAX_SIDE:
        asked = f"{camera.width}×{camera.height}"
        raise ValueError(f"backend cpu renders up to {MAX_SIDE} px a side; {asked} was requested")
    packed = pack_camera(camera.viewmat.detach().numpy(), camera.K.detach().numpy(), *camera[2:])
    (background,) = _arrays([options.background])
    if background is None:
        background = np.zeros(channels.colors, np.float32)
    return Settings(packed, camera.width, camera.height, channels, background, pack_limits(options.blending))


BACKEND = CpuBackend()
