"""A set of Gaussians in training: render it, let its density change, move it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityControl
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.rasterization import render_view
from tdgbench.training.budget import Budget


@dataclass
class Render:
    """What a camera sees. depth is the accumulated z (TDg, eq. 3), None where it was not asked for."""

    image: Tensor  # (H, W, C)
    transmittance: Tensor  # (H, W)
    depth: Tensor | None  # (H, W)
    means2d: Tensor  # (N, 2) px; has .grad after backward
    radii: Tensor  # (N,) px

    @property
    def alpha(self) -> Tensor:
        """(H, W): the share of the pixel that is covered."""
        return 1.0 - self.transmittance


def render_gaussians(
    gaussians: Gaussians, camera: Camera, *, degree: int, depth: bool = False, backend: str = "auto"
) -> Render:
    """Render before a black background, colour and depth in one pass."""
    like = gaussians.means
    view = render_view(
        like,
        gaussians.quats,
        gaussians.scales,
        gaussians.opacities,
        gaussians.sh,
        torch.as_tensor(camera.world_to_camera, dtype=like.dtype, device=like.device),
        torch.as_tensor(camera.K, dtype=like.dtype, device=like.device),
        camera.width,
        camera.height,
        sh_degree=degree,
        depth=depth,
        backend=backend,
    )
    return Render(view.image, view.transmittance, view.depth, view.means2d, view.radii)


class SplatModel:
    """Gaussians with their optimiser and density control."""

    def __init__(
        self, gaussians: Gaussians, budget: Budget, extent: float, backend: str, generator: torch.Generator
    ) -> None:
        self.gaussians = gaussians.as_leaves()
        self.budget = budget
        self.backend = backend
        self.degree = 0
        self.optimizer = Adam(self.gaussians, budget.rates, extent)
        self.density = DensityControl(budget.density, extent, len(gaussians))
        self._generator = generator
        self._last: tuple[Render, Camera] | None = None

    def __len__(self) -> int:
        return len(self.gaussians)

    def render(self, camera: Camera, *, depth: bool = False) -> Render:
        """Render at the degree in use. The last render with gradients is the one that density control observes."""
        render = render_gaussians(self.gaussians, camera, degree=self.degree, depth=depth, backend=self.backend)
        if torch.is_grad_enabled():
            self._last = (render, camera)
        return render

    def begin(self, iteration: int) -> None:
        """Before an iteration (1-based): raise the SH degree if it is time."""
        self.degree = self.budget.active_degree(iteration)

    def finish(self, iteration: int) -> None:
        """After the backward pass: density control, then Adam (which skips parameters that were just replaced)."""
        if self._last is not None and self.density.is_active(iteration):
            render, camera = self._last
            if render.means2d.grad is not None:
                self.density.observe(render.means2d.grad, render.radii, camera.width, camera.height)
        self._last = None
        self.gaussians, _ = self.density.update(self.gaussians, self.optimizer, iteration, self._generator)
        self.optimizer.step(self.gaussians, iteration)
