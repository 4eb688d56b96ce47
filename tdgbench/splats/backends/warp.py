"""The `warp` backend: kernels in NVIDIA Warp (the extra `warp`), for a CUDA GPU, or slowly on the CPU.

Sums have a fixed order: the same input gives the same bytes on the same device.
"""

from __future__ import annotations

import importlib.util
from functools import cache

import torch
from torch import Tensor

from tdgbench.splats import torch_losses
from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.gradients import Gradients, GradientStatistics, PendingGradients, Rows, RowSteps
from tdgbench.splats.torch_losses import LossWeights
from tdgbench.splats.view import GaussianTensors, Pinhole, Projection, Render, RenderOptions


class WarpBackend(Backend):
    """Float32 on a CUDA GPU, or on the CPU of a machine without one."""

    inputs = "float32 tensors on the CPU or a CUDA GPU"
    devices = ("cpu", "cuda")
    package = "warp-lang"

    @property
    def device(self) -> str:  # type: ignore[override]
        """Type of the device on which it trains."""
        return "cuda" if torch.cuda.is_available() else "cpu"

    def why_not(self) -> str | None:
        return import_problem(torch.cuda.is_available())

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        from tdgbench.splats.warp.arrays import view_of
        from tdgbench.splats.warp.passes import Request, WarpRasterize

        *tensors, sh_degree = gaussians
        means, quats, scales, opacities, colors = (
            tensor.contiguous() if tensor.dim() > 1 and tensor.stride(-1) != 1 else tensor for tensor in tensors
        )
        if not options.blending.min_alpha > 0:
            raise ValueError("backend warp needs a min_alpha above 0, which bounds each Gaussian")
        if colors.dim() == 2:
            colors = colors[:, None, :]
        probe = means.new_empty(len(means), 2).requires_grad_(torch.is_grad_enabled() and means.requires_grad)
        absgrad = torch.zeros_like(probe, requires_grad=False) if options.absgrad else None
        request = Request(view_of(camera, sh_degree, options.blending), options.depth, absgrad)
        light, transmittance, radii, depths = WarpRasterize.apply(
            means, quats, scales, opacities, colors, probe, request
        )
        image, depth = (light[..., :-1], light[..., -1]) if options.depth else (light, None)
        if options.background is not None:
            image = image + transmittance[..., None] * options.background.to(image)
        return Render(image, depth, transmittance, Projection(probe, radii, depths, absgrad))

    def steps_of(self, state: Rows) -> RowSteps:
        from tdgbench.splats.warp.training import WarpSteps

        return WarpSteps(state)

    def observe_visible(self, view: Gradients | PendingGradients, view_counts: Tensor, max_radii: Tensor) -> None:
        from tdgbench.splats.warp import training

        training.observe_visible(view.compute(), view_counts, max_radii)

    def observe_gradients(self, gradients: Gradients, sums: GradientStatistics) -> None:
        from tdgbench.splats.warp import training

        training.observe_gradients(gradients, sums)

    def l1_and_dssim(self, image: Tensor, target: Tensor, weights: LossWeights, valid: Tensor | None) -> Tensor:
        from tdgbench.splats.warp.losses import L1AndDssim

        count, target, of_pixels = torch_losses.valid_values(image, valid), target.detach(), image.new_empty(0, 0)
        if valid is not None:
            image, target = (torch_losses.without_masked(t, valid) for t in (image, target))
            of_pixels = valid.to(image.dtype)
        return L1AndDssim.apply(image, target, of_pixels, weights[:2], count)


@cache
def import_problem(on_gpu: bool) -> str | None:
    """Return why Warp cannot be imported, or does not run on the GPU that torch found; None if it can be used."""
    if importlib.util.find_spec("warp") is None:
        return "warp-lang is not installed: pip install -e '.[warp]'"
    try:
        import warp

        import tdgbench.splats.warp.arrays  # noqa: F401, sets Warp up
    except Exception as error:  # of another package of this name, too
        return f"warp-lang cannot be imported ({type(error).__name__}: {(str(error).splitlines() or [''])[0]})"
    if on_gpu and not warp.is_cuda_available():
        return (
            f"the NVIDIA driver is too old for warp-lang {warp.__version__}: its wheel on PyPI is built for CUDA "
            "13 and needs driver 580 or newer; update the driver, or install NVIDIA's wheel for CUDA 12"
        )
    return None


BACKEND = WarpBackend()
