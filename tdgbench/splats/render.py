"""Render one camera's view on a backend: of tensors, or of a state in training."""

from __future__ import annotations

from torch import Tensor

from tdgbench.splats.backends import choose_backend, load_backend
from tdgbench.splats.backends.backend import Collect, StateOptions, SumFootprints
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.geometry import with_pose_gradient
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import GaussianTensors, Pinhole, Render, RenderOptions


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

    >>> import torch
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
