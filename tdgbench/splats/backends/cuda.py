"""The `cuda` backend: gsplat (the extra `cuda`), with 3DGS's conventions where it allows.

What differs from the other backends, by gsplat's own constants (1.5.3): alpha is capped at 0.999 rather than 0.99, and
a Gaussian's radius ends where its opacity falls below 1/255, not at 3 σ, so that density control may count a faint one
as unseen at the border. The rest is the same: alpha below 1/255 is skipped, a pixel stops at transmittance 1e-4, eps2d
is added to the image covariance, depth is the accumulated z.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import torch
from torch import Tensor

from tdgbench.splats.view import RenderedView


def why_not() -> str | None:
    """Why this backend cannot run here; None if it can."""
    if importlib.util.find_spec("gsplat") is None:
        return "gsplat is not installed: pip install 'tdgbench[cuda]'"
    if not torch.cuda.is_available():
        return "torch finds no CUDA GPU"
    return None


def rasterize(means, quats, scales, opacities, colors, viewmat, K, width, height, *, near_plane, far_plane,
              eps2d, sh_degree, background, depth_channel) -> RenderedView:  # fmt: skip
    """Render one camera; what `tdgbench.splats.backends.reference.rasterize` does, on a GPU."""
    from gsplat import rasterization

    rendered, alphas, meta = rasterization(
        means, quats, scales, opacities, colors, viewmat[None], K[None], width, height, near_plane=near_plane,
        far_plane=far_plane, eps2d=eps2d, sh_degree=sh_degree, packed=False, tile_size=16,
        render_mode="RGB+D" if depth_channel else "RGB",
    )  # fmt: skip
    transmittance = 1.0 - alphas[0, ..., 0]
    depth = rendered[0, ..., -1] if depth_channel else None
    image = rendered[0, ..., :-1] if depth_channel else rendered[0]
    if background is not None:
        image = image + transmittance[..., None] * background
    radii = meta["radii"][0]
    if radii.dim() == 2:  # one per axis since 1.5
        radii = radii.amax(dim=1) * (radii > 0).all(dim=1)
    probe = _probe_of(meta["means2d"])
    return RenderedView(image, depth, transmittance, probe, meta["depths"][0], radii.to(torch.int32))


def _probe_of(means2d: Tensor) -> Any:
    """A tensor (N, 2) that holds the image means, and in `.grad` their gradient once a backward pass is through."""
    probe = means2d[0].detach().clone()
    if means2d.requires_grad:
        probe.requires_grad_()

        def receive(grad: Tensor) -> None:
            probe.grad = grad[0].clone()

        means2d.register_hook(receive)
    return probe
