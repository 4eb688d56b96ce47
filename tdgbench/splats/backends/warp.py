"""The `warp` backend: kernels in NVIDIA Warp (the extra `warp`), for a CUDA GPU, or slowly on the CPU.

Sums have a fixed order: the same input gives the same bytes on the same device.
"""

from __future__ import annotations

import importlib.util
from functools import cache

import torch

from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.view import GaussianTensors, Pinhole, Projection, Render, RenderOptions


class WarpBackend(Backend):
    """Float32 on a CUDA GPU, or on the CPU where there is none."""

    inputs = "float32 tensors on the CPU or a CUDA GPU"
    package = "warp-lang"

    @property
    def device(self) -> str:  # type: ignore[override]
        """Type of the device on which it trains."""
        return "cuda" if torch.cuda.is_available() else "cpu"

    def takes(self, device: torch.device, dtype: torch.dtype) -> bool:
        return device.type in ("cpu", "cuda") and dtype == torch.float32

    def why_not(self) -> str | None:
        if importlib.util.find_spec("warp") is None:
            return "warp-lang is not installed: pip install -e '.[warp]'"
        return _import_problem(torch.cuda.is_available())

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        from tdgbench.splats.warp.arrays import view_of
        from tdgbench.splats.warp.passes import Rasterize, Request

        means, quats, scales, opacities, colors, sh_degree = gaussians
        if not options.blending.min_alpha > 0:
            raise ValueError("backend warp needs a min_alpha above 0, which bounds each Gaussian")
        if colors.dim() == 2:
            colors = colors[:, None, :]
        probe = means.new_empty(len(means), 2).requires_grad_(torch.is_grad_enabled() and means.requires_grad)
        absgrad = torch.zeros_like(probe, requires_grad=False) if options.absgrad else None
        request = Request(view_of(camera, sh_degree, options.blending), options.depth, absgrad)
        light, transmittance, radii, depths = Rasterize.apply(means, quats, scales, opacities, colors, probe, request)
        image, depth = (light[..., :-1], light[..., -1]) if options.depth else (light, None)
        if options.background is not None:
            image = image + transmittance[..., None] * options.background.to(image)
        return Render(image, depth, transmittance, Projection(probe, radii, depths, absgrad))


@cache
def _import_problem(on_gpu: bool) -> str | None:
    """Return why Warp cannot be imported, or does not run on the GPU that torch found; None if it can be used."""
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
