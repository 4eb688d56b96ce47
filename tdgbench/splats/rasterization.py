"""The public face of the splat core: `rasterization`, with gsplat's name, order and shapes."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from tdgbench.splats.backends import cpu, cuda, reference
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.harmonics import num_bases
from tdgbench.splats.view import RenderedView

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
BACKENDS = ("auto", "reference", "cpu", "cuda")
NEAR_PLANE, FAR_PLANE, EPS2D = 0.2, 1e10, 0.3  # 3DGS; px² for the last


def choose_backend(backend: str, device: torch.device, dtype: torch.dtype) -> str:
    """What `auto` means: float32 goes to `cpu` or `cuda` by its device, everything else to the general `reference`.

    Raises ValueError if a backend cannot take such tensors, RuntimeError if it cannot run here.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend is {backend!r}; it must be one of {', '.join(BACKENDS)}")
    if backend == "auto":
        return device.type if device.type in ("cpu", "cuda") and dtype == torch.float32 else "reference"
    if backend in ("cpu", "cuda") and (device.type != backend or dtype != torch.float32):
        where = "the CPU" if backend == "cpu" else "a CUDA GPU"
        raise ValueError(
            f"backend {backend} takes float32 tensors on {where}, not {dtype} on {device}; use 'reference'"
        )
    if backend == "cuda" and (reason := cuda.why_not()) is not None:
        raise RuntimeError(f"backend cuda cannot run: {reason}")
    return backend


def rasterization(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    *,
    near_plane: float = NEAR_PLANE,
    far_plane: float = FAR_PLANE,
    eps2d: float = EPS2D,
    sh_degree: int | None = None,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    backend: str = "auto",
    blending: Blending = AS_3DGS,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Splat N Gaussians into C cameras.

    Args:
        means: (N, 3) centres in world coordinates.
        quats: (N, 4) rotations, wxyz; normalised inside.
        scales: (N, 3) standard deviations along the axes, > 0.
        opacities: (N,) in [0, 1].
        colors: (N, D), or (N, K, D) spherical-harmonics coefficients with `sh_degree`.
        viewmats: (C, 4, 4) world-to-camera, OpenCV axes (x right, y down, z forward).
        Ks: (C, 3, 3) pinhole intrinsics in pixels; pixel centres lie at whole numbers + 1/2.
        near_plane, far_plane: Gaussians whose camera-space z is outside are not drawn.
        eps2d: added to the diagonal of the image covariance, px².
        sh_degree: degree of the harmonics to use (0 to 3; at most that of `colors`).
        backgrounds: (C, D) colour behind the Gaussians; None is black. Depth has no background.
        render_mode: "RGB", "D" (accumulated z, Σ z_k w_k: TDg, eq. 3), "ED" (that divided by alpha),
            "RGB+D", "RGB+ED" (depth is the last channel).
        backend: "auto", "reference", "cpu" or "cuda".
        blending: the constants below, and shortcuts of the `cpu` backend; gsplat has its own.

    Returns:
        renders (C, H, W, D [+ 1]), alphas (C, H, W, 1) and meta: `means2d` (list of C tensors (N, 2), px; after
        backward each has `.grad`), `radii` (C, N) in px (0: unseen), `depths` (C, N), `backend`, `width`, `height`.

    3DGS's blending constants: alpha ≤ 0.99, skipped below 1/255, stop at transmittance 1e-4. Results do not
    depend on tiles. A NaN in any Gaussian makes the whole image NaN. Raises ValueError for shapes or options that do
    not fit.
    """
    _check(means, quats, scales, opacities, colors, viewmats, Ks, width, height, sh_degree, backgrounds)
    if render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode is {render_mode!r}; it must be one of {', '.join(RENDER_MODES)}")
    if render_mode in ("D", "ED"):
        colors, sh_degree, backgrounds = colors.new_zeros(len(means), 0), None, None
    views = [
        render_view(
            means, quats, scales, opacities, colors, viewmats[c], Ks[c], width, height, near_plane=near_plane,
            far_plane=far_plane, eps2d=eps2d, sh_degree=sh_degree,
            background=None if backgrounds is None else backgrounds[c], depth="D" in render_mode,
            backend=backend, blending=blending,
        )
        for c in range(len(viewmats))
    ]  # fmt: skip
    alphas = torch.stack([1.0 - view.transmittance for view in views])[..., None]
    renders = torch.stack([view.image for view in views])
    if "D" in render_mode:
        depth = torch.stack([view.depth for view in views if view.depth is not None])[..., None]
        if "ED" in render_mode:
            depth = depth / alphas.clamp_min(1e-10)
        renders = torch.cat([renders, depth], dim=-1)
    meta = {
        "means2d": [view.means2d for view in views],
        "radii": torch.stack([view.radii for view in views]),
        "depths": torch.stack([view.depths for view in views]),
        "backend": choose_backend(backend, means.device, means.dtype),
        "width": width,
        "height": height,
    }
    return renders, alphas, meta


def render_view(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    *,
    near_plane: float = NEAR_PLANE,
    far_plane: float = FAR_PLANE,
    eps2d: float = EPS2D,
    sh_degree: int | None = None,
    background: Tensor | None = None,
    depth: bool = False,
    backend: str = "auto",
    blending: Blending = AS_3DGS,
) -> RenderedView:
    """One camera's view, its parts in tensors of their own: what training uses, without joining and cutting them.

    Arguments as in `rasterization`, for one camera: viewmat (4, 4), K (3, 3), background (D,).
    """
    if not near_plane > 0:
        raise ValueError(f"near_plane is {near_plane}; it must be above 0")
    options: dict[str, Any] = {"near_plane": near_plane, "far_plane": far_plane, "eps2d": eps2d, "sh_degree": sh_degree}
    chosen = choose_backend(backend, means.device, means.dtype)
    if chosen != "cuda":
        options["blending"] = blending
    elif blending != AS_3DGS:
        raise ValueError("backend cuda blends with gsplat's own constants; leave `blending` as it is")
    rasterize: Any = {"cpu": cpu.rasterize, "cuda": cuda.rasterize, "reference": reference.rasterize}[chosen]
    return rasterize(
        means, quats, scales, opacities, colors, viewmat, K, width, height,
        background=background, depth_channel=depth, **options,
    )  # fmt: skip


def _check(means, quats, scales, opacities, colors, viewmats, Ks, width, height, sh_degree, backgrounds):
    """Raise ValueError with the name of the first argument whose shape does not fit."""
    n = len(means)
    expected = {
        "means": (means, (n, 3)),
        "quats": (quats, (n, 4)),
        "scales": (scales, (n, 3)),
        "opacities": (opacities, (n,)),
        "viewmats": (viewmats, (len(viewmats), 4, 4)),
        "Ks": (Ks, (len(viewmats), 3, 3)),
    }
    for name, (tensor, shape) in expected.items():
        if tuple(tensor.shape) != shape:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}; expected {shape}")
    if len(viewmats) < 1:
        raise ValueError("viewmats is empty; give at least one camera")
    dims = 2 if sh_degree is None else 3
    if colors.dim() != dims or len(colors) != n:
        kind = "(N, D)" if sh_degree is None else "(N, K, D) with sh_degree"
        raise ValueError(f"colors has shape {tuple(colors.shape)}; expected {kind} with N = {n}")
    if sh_degree is not None and colors.shape[1] < num_bases(sh_degree):
        raise ValueError(
            f"colors has {colors.shape[1]} coefficients; sh_degree {sh_degree} needs {num_bases(sh_degree)}"
        )
    if backgrounds is not None and tuple(backgrounds.shape) != (len(viewmats), colors.shape[-1]):
        raise ValueError(
            f"backgrounds has shape {tuple(backgrounds.shape)}; expected {(len(viewmats), colors.shape[-1])}"
        )
    if width < 1 or height < 1:
        raise ValueError(f"the image is {width}×{height}; both must be 1 or more")
