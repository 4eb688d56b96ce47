"""Render one camera's view on a backend, of tensors or of a state in training; `rasterization` is gsplat's function."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from tdgbench.splats.backends import choose_backend, load_backend
from tdgbench.splats.backends.backend import Collect, StateOptions, SumFootprints
from tdgbench.splats.geometry import with_pose_gradient
from tdgbench.splats.harmonics import num_bases
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import (
    AS_3DGS,
    EPS2D,
    FAR_PLANE,
    NEAR_PLANE,
    Blending,
    GaussianTensors,
    Pinhole,
    Render,
    RenderOptions,
)

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")


def render_view(
    gaussians: GaussianTensors,
    camera: Pinhole,
    *,
    depth: bool = False,
    background: Tensor | None = None,
    blending: Blending = AS_3DGS,
    absgrad: bool = False,
    backend: str = "auto",
) -> Render:
    """Render one view; the options are those of `RenderOptions`. A pose that requires a gradient gets one.

    Raises ValueError for what the backend cannot render.

    >>> one = GaussianTensors(
    ...     means=torch.tensor([[0.0, 0.0, 2.0]]), quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
    ...     scales=torch.full((1, 3), 5.0), opacities=torch.tensor([0.8]), colors=torch.tensor([[0.5]]),
    ... )
    >>> K = torch.tensor([[8.0, 0.0, 4.0], [0.0, 8.0, 4.0], [0.0, 0.0, 1.0]])
    >>> view = render_view(one, Pinhole(torch.eye(4), K, 8, 8), depth=True, backend="reference")
    >>> [round(value[4, 4].item(), 2) for value in (view.image, view.depth, view.alpha)]
    [0.4, 1.6, 0.8]
    """
    if not camera.near_plane > 0:
        raise ValueError(f"near_plane is {camera.near_plane}; it must be above 0")
    channels = gaussians.colors.shape[-1]
    if background is not None and background.shape != (channels,):
        raise ValueError(f"the background has the shape {tuple(background.shape)}; it must be ({channels},)")
    chosen = choose_backend(backend, gaussians.means.device, gaussians.means.dtype)
    gaussians, camera = with_pose_gradient(gaussians, camera)
    return load_backend(chosen).render(gaussians, camera, RenderOptions(depth, background, blending, absgrad))


def footprint_sums(gaussians: GaussianTensors, channels: int, backend: str = "auto") -> SumFootprints:
    """Return a function of a camera and maps (H, W, channels) that sums these over each Gaussian's footprint.

    Colours are not used. See `Backend.footprint_sums`.
    """
    chosen = choose_backend(backend, gaussians.means.device, gaussians.means.dtype)
    return load_backend(chosen).footprint_sums(gaussians, channels)


def render_state(
    state: TrainingState,
    optimizer: Adam,
    camera: Pinhole,
    options: StateOptions,
    collect: Collect,
    backend: str = "auto",
) -> Render:
    """Render one view of a state in training; the backward pass calls collect(Gradients)."""
    like = state.values
    chosen = choose_backend(backend, like.device, like.dtype)
    return load_backend(chosen).render_state(state, optimizer.row_steps, camera, options, collect)


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
    absgrad: bool = False,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Splat N Gaussians into C cameras, with gradients.

    The Gaussians are those of `GaussianTensors`, the cameras those of `Pinhole`: viewmats (C, 4, 4), Ks (C, 3, 3) px.
    sh_degree: degree of the harmonics in use, 0 to 3, at most that of `colors`. backgrounds: (C, D), default black.
    render_mode: "RGB", "D" (accumulated z, Σ z_k w_k: TDg, eq. 3), "ED" (that over alpha), "RGB+D" or "RGB+ED"
    (depth is the last channel). backend: "auto" or a module of `tdgbench.splats.backends`. blending: by default that
    of 3DGS; `cuda` has gsplat's. absgrad: the backward pass also adds up absolute gradients (AbsGS).

    Returns renders (C, H, W, D [+ 1]), alphas (C, H, W, 1), and meta with `means2d` (C tensors (N, 2) px, whose `.grad`
    the backward pass sets), `radii` (C, N) px (0: not visible), `depths` (C, N), `backend`, `width` and `height`.
    `absgrad`: with that option C tensors (N, 2), Σ over pixels of |d loss / d means2d|, which the backward pass sets.
    A NaN in means or scales, or in any visible Gaussian, makes every image NaN. Raises ValueError for shapes or options
    that do not fit.

    >>> means, quats = torch.tensor([[0.0, 0.0, 2.0]]), torch.tensor([[1.0, 0.0, 0.0, 0.0]])
    >>> scales, opacities, colors = torch.full((1, 3), 0.1), torch.tensor([0.5]), torch.ones(1, 3)
    >>> Ks = torch.tensor([[[8.0, 0.0, 4.0], [0.0, 8.0, 4.0], [0.0, 0.0, 1.0]]])
    >>> renders, alphas, meta = rasterization(means, quats, scales, opacities, colors, torch.eye(4)[None], Ks, 8, 8)
    >>> tuple(renders.shape), tuple(alphas.shape), meta["backend"], meta["means2d"][0].tolist(), meta["radii"].tolist()
    ((1, 8, 8, 3), (1, 8, 8, 1), 'cpu', [[4.0, 4.0]], [[3]])
    """
    gaussians = GaussianTensors(means, quats, scales, opacities, colors, sh_degree)
    _check(gaussians, viewmats, Ks, (width, height), backgrounds, render_mode)
    if render_mode in ("D", "ED"):
        gaussians, backgrounds = gaussians._replace(colors=colors.new_zeros(len(means), 0), sh_degree=None), None
    behind = [None] * len(viewmats) if backgrounds is None else backgrounds
    views = [
        render_view(
            gaussians, Pinhole(viewmat, K, width, height, near_plane, far_plane, eps2d), depth="D" in render_mode,
            background=background, blending=blending, absgrad=absgrad, backend=backend,
        )
        for viewmat, K, background in zip(viewmats, Ks, behind, strict=True)
    ]  # fmt: skip
    projections = [view.projection for view in views if view.projection is not None]
    return *_stack(views, render_mode), {
        "means2d": [projection.means2d for projection in projections],
        "radii": torch.stack([projection.radii for projection in projections]),
        "depths": torch.stack([projection.depths for projection in projections]),
        "absgrad": [projection.absgrad for projection in projections if projection.absgrad is not None],
        "backend": choose_backend(backend, means.device, means.dtype),
        "width": width,
        "height": height,
    }


def _stack(views: list[Render], render_mode: str) -> tuple[Tensor, Tensor]:
    """Return renders (C, H, W, D [+ 1]) and alphas (C, H, W, 1) of the views."""
    alphas = torch.stack([view.alpha for view in views])[..., None]
    renders = torch.stack([view.image for view in views])
    if "D" in render_mode:
        depth = torch.stack([view.depth for view in views if view.depth is not None])[..., None]
        if "ED" in render_mode:
            depth = depth / alphas.clamp_min(1e-10)
        renders = torch.cat([renders, depth], dim=-1)
    return renders, alphas


def _check(
    gaussians: GaussianTensors,
    viewmats: Tensor,
    Ks: Tensor,
    size: tuple[int, int],
    backgrounds: Tensor | None,
    render_mode: str,
) -> None:
    """Raise ValueError with the name of the first argument that does not fit."""
    n, cameras = len(gaussians.means), len(viewmats)
    expected = {
        "means": (gaussians.means, (n, 3)),
        "quats": (gaussians.quats, (n, 4)),
        "scales": (gaussians.scales, (n, 3)),
        "opacities": (gaussians.opacities, (n,)),
        "viewmats": (viewmats, (cameras, 4, 4)),
        "Ks": (Ks, (cameras, 3, 3)),
    }
    if backgrounds is not None:
        expected["backgrounds"] = (backgrounds, (cameras, gaussians.colors.shape[-1]))
    for name, (tensor, shape) in expected.items():
        if tuple(tensor.shape) != shape:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}; expected {shape}")
    _check_colors(gaussians.colors, n, gaussians.sh_degree)
    if cameras < 1:
        raise ValueError("viewmats is empty; give at least one camera")
    if min(size) < 1:
        raise ValueError(f"the image is {size[0]}×{size[1]}; both must be 1 or more")
    if render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode is {render_mode!r}; it must be one of {', '.join(RENDER_MODES)}")


def _check_colors(colors: Tensor, n: int, sh_degree: int | None) -> None:
    """Raise ValueError if colours do not fit `n` Gaussians, or lack coefficients of the degree."""
    dims = 2 if sh_degree is None else 3
    if colors.dim() != dims or len(colors) != n:
        kind = "(N, D)" if sh_degree is None else "(N, K, D) with sh_degree"
        raise ValueError(f"colors has shape {tuple(colors.shape)}; expected {kind} with N = {n}")
    if sh_degree is not None and colors.shape[1] < num_bases(sh_degree):
        raise ValueError(
            f"colors has {colors.shape[1]} coefficients; sh_degree {sh_degree} needs {num_bases(sh_degree)}"
        )
