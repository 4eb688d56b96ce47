"""The `cuda` backend: gsplat (the extra `cuda`), with 3DGS's conventions where it allows.

gsplat's constants (1.5.3) differ from the other backends: alpha is capped at 0.999 rather than 0.99, and a Gaussian's
radius ends where its alpha falls below 1/255, not at 3 σ, so that density control may not count a faint one at the
border as visible. The rest is the same: alpha below 1/255 is skipped, a pixel stops at transmittance 1e-4, eps2d is
added to the image covariance, depth is the accumulated z.
"""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import torch
from torch import Tensor

from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.view import GaussianTensors, Pinhole, Projection, Render, RenderOptions


class CudaBackend(Backend):
    """Float32 on a CUDA GPU, by gsplat."""

    device = "cuda"
    inputs = "float32 tensors on a CUDA GPU"

    def takes(self, device: torch.device, dtype: torch.dtype) -> bool:
        return device.type == "cuda" and dtype == torch.float32

    def why_not(self) -> str | None:
        if importlib.util.find_spec("gsplat") is None:
            return "gsplat is not installed: pip install 'tdgbench[cuda]'"
        if not torch.cuda.is_available():
            return "torch finds no CUDA GPU"
        return None

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        from gsplat import rasterization

        if replace(options.blending, tight=AS_3DGS.tight, end_early=AS_3DGS.end_early) != AS_3DGS:
            raise ValueError("backend cuda blends with gsplat's constants; leave `blending` as it is")
        means, quats, scales, opacities, colors, sh_degree = gaussians
        rendered, alphas, meta = rasterization(
            means, quats, scales, opacities, colors, camera.viewmat[None], camera.K[None], camera.width, camera.height,
            near_plane=camera.near_plane, far_plane=camera.far_plane, eps2d=camera.eps2d, sh_degree=sh_degree,
            packed=False, tile_size=16, render_mode="RGB+D" if options.depth else "RGB",
        )  # fmt: skip
        transmittance = 1.0 - alphas[0, ..., 0]
        depth = rendered[0, ..., -1] if options.depth else None
        image = rendered[0, ..., :-1] if options.depth else rendered[0]
        if options.background is not None:
            image = image + transmittance[..., None] * options.background
        radii = meta["radii"][0]
        if radii.dim() == 2:  # one per axis since 1.5
            radii = radii.amax(dim=1) * (radii > 0).all(dim=1)
        projection = Projection(_probe_of(meta["means2d"]), radii.to(torch.int32), meta["depths"][0])
        return Render(image, depth, transmittance, projection)


def _probe_of(means2d: Tensor) -> Tensor:
    """Image means (N, 2) of gsplat's (1, N, 2); the backward pass sets `.grad`."""
    probe = means2d[0].detach().clone()
    if means2d.requires_grad:
        probe.requires_grad_()

        def receive(grad: Tensor) -> None:
            probe.grad = grad[0].clone()

        means2d.register_hook(receive)
    return probe


BACKEND = CudaBackend()
