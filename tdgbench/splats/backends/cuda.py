"""The `cuda` backend: gsplat (the extra `cuda`), with 3DGS's conventions where it allows.

Constants of gsplat differ from those of the other backends (nerfstudio-project/gsplat, v1.5.3 and 1db12c01): before
1.6, alpha is capped at 0.999 rather than 0.99 (RasterizeToPixels3DGSFwd.cu; changed by c5ff586b). A Gaussian's radius
ends where its alpha falls below 1/255, not at 3 σ (ProjectionEWA3DGSFused.cu), so that density control may not count a
faint one at the border as visible. gsplat hides NaN, which the adapter puts into the image. The rest is the same: alpha
below 1/255 is skipped, a pixel stops at transmittance 1e-4, eps2d is added to the image covariance, depth is the
accumulated z. Before 1.6, harmonics have three channels (rendering.py asserts it); others are filled up with zeros.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import torch
from torch import Tensor

from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.view import AS_3DGS, Blending, GaussianTensors, Pinhole, Projection, Render, RenderOptions

SH_CHANNELS = 3
MAX_ALPHA_BEFORE_1_6 = 0.999


class CudaBackend(Backend):
    """Float32 on a CUDA GPU, by gsplat."""

    device = "cuda"
    package = "gsplat"
    inputs = "float32 tensors on a CUDA GPU"
    devices = ("cuda",)

    def why_not(self) -> str | None:
        if importlib.util.find_spec("gsplat") is None:
            return "gsplat is not installed: pip install -e '.[cuda]'"
        if not torch.cuda.is_available():
            return "torch finds no CUDA GPU"
        return _import_problem()

    def constants(self, packages: Mapping[str, str | None] | None = None) -> Blending | None:
        version = self.version() if packages is None else packages.get("gsplat")
        return AS_3DGS if _release(version) >= (1, 6) else replace(AS_3DGS, max_alpha=MAX_ALPHA_BEFORE_1_6)

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        from gsplat import rasterization

        if replace(options.blending, end_early=AS_3DGS.end_early) != AS_3DGS:
            raise ValueError("backend cuda blends with gsplat's constants; leave `blending` as it is")
        means, quats, scales, opacities, colors, sh_degree = gaussians
        channels, camera = colors.shape[-1], camera.to(means)
        if sh_degree is not None and channels < SH_CHANNELS:
            colors = torch.nn.functional.pad(colors, (0, SH_CHANNELS - channels))
        asked = {"absgrad": True} if options.absgrad else {}
        mode = "RGB" if not options.depth else "RGB+D" if channels else "D"
        rendered, alphas, meta = rasterization(
            means, quats, scales, opacities, colors, camera.viewmat[None], camera.K[None], camera.width, camera.height,
            near_plane=camera.near_plane, far_plane=camera.far_plane, eps2d=camera.eps2d, sh_degree=sh_degree,
            packed=False, tile_size=16, render_mode=mode, **asked,
        )  # fmt: skip
        transmittance = 1.0 - alphas[0, ..., 0]
        depth = rendered[0, ..., -1] if options.depth else None
        image = rendered[0, ..., :channels]
        if options.background is not None:
            image = image + transmittance[..., None] * options.background.to(image)
        # gsplat culls a Gaussian whose mean is NaN, and draws one whose opacity is; a training must notice both.
        broken = torch.stack([torch.isnan(part).any() for part in (means, quats, scales, opacities, colors)]).any()
        image = torch.where(broken, torch.nan, image)
        by_axis = meta["radii"][0]
        radii = by_axis.amax(dim=1) * (by_axis > 0).all(dim=1)
        absgrad = torch.zeros_like(meta["means2d"][0].detach()) if options.absgrad else None
        probe = _probe_of(meta["means2d"], absgrad)
        projection = Projection(probe, radii.to(torch.int32), meta["depths"][0], absgrad)
        return Render(image, depth, transmittance, projection)


@cache
def _import_problem() -> str | None:
    """Return why gsplat cannot be imported, or has no kernels; None if it can be used.

    The import compiles the kernels, if nvcc is there. Without it, gsplat is imported all the same, with None in their
    place (gsplat/cuda/_backend.py of v1.5.3).
    """
    try:
        importlib.import_module("gsplat")
        kernels = importlib.import_module("gsplat.cuda._backend")
    except Exception as error:  # of a build for another torch, too
        text = str(error).splitlines() or [""]
        return f"gsplat cannot be imported ({type(error).__name__}: {text[0]})"
    if getattr(kernels, "_C", kernels) is None:  # a release without this name is left to the check of its results
        return (
            "gsplat finds no nvcc to compile its kernels with: install the CUDA toolkit "
            f"{torch.version.cuda}, for which torch was built, and a C++ compiler"
        )
    return None


def _release(version: str | None) -> tuple[int, ...]:
    """Return the first two numbers of a version; of 1.5.3 where it is not known.

    >>> _release("1.6.0+pt29cu128"), _release(None)
    ((1, 6), (1, 5))
    """
    found = re.match(r"(\d+)\.(\d+)", version or "")
    return (int(found[1]), int(found[2])) if found else (1, 5)


def _probe_of(means2d: Tensor, absgrad: Tensor | None) -> Tensor:
    """Image means (N, 2) of gsplat's (1, N, 2); the backward pass sets `.grad`, and adds to absgrad (N, 2).

    gsplat sets `means2d.absgrad` (1, N, 2) before torch calls the hook of means2d.
    """
    probe = means2d[0].detach().clone()
    if means2d.requires_grad:
        probe.requires_grad_()

        def receive(grad: Tensor) -> None:
            probe.grad = grad[0].clone()
            if absgrad is not None:
                absgrad.add_(vars(means2d)["absgrad"][0])

        means2d.register_hook(receive)
    return probe


BACKEND = CudaBackend()
