"""A set of Gaussians in training: render it, let its density change, move it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityControl
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.render import render_state
from tdgbench.splats.state import TrainingState
from tdgbench.training.budget import Budget


@dataclass
class Render:
    """What a camera sees, before black. depth is the accumulated z (TDg, eq. 3), None where it was not asked for."""

    image: Tensor  # (H, W, C)
    transmittance: Tensor  # (H, W)
    depth: Tensor | None  # (H, W)

    @property
    def alpha(self) -> Tensor:
        """(H, W): the share of the pixel that is covered."""
        return 1.0 - self.transmittance

    def cpu(self) -> Render:
        """The same on the CPU."""
        return Render(self.image.cpu(), self.transmittance.cpu(), None if self.depth is None else self.depth.cpu())


class SplatModel:
    """Gaussians with their optimiser and density control."""

    def __init__(
        self, gaussians: Gaussians, budget: Budget, extent: float, backend: str, generator: torch.Generator
    ) -> None:
        self.state = TrainingState(gaussians)
        self.budget = budget
        self.backend = backend
        self.degree = 0
        self.optimizer = Adam(self.state, budget.rates, extent)
        self.density = DensityControl(budget.density, extent, self.state)
        self._generator = generator
        self._iteration = 0
        self._gradients: list[Gradients] = []

    def __len__(self) -> int:
        return len(self.state)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now; they share memory with the model."""
        self.optimizer.settle()
        return self.state.split(self.state.values)

    def render(self, camera: Camera, *, depth: bool = False) -> Render:
        """Render at the degree in use, colour and depth in one pass. With gradients it counts for density control."""
        size = (camera.width, camera.height)

        def collect(gradients: Gradients) -> None:
            self._gradients.append(gradients)
            if self.density.is_active(self._iteration):
                self.density.observe(gradients, *size)

        image, depth_map, transmittance = render_state(
            self.state, self.optimizer, camera.world_to_camera, camera.K, *size, degree=self.degree, depth=depth,
            iteration=self._iteration, backend=self.backend, collect=collect,
        )  # fmt: skip
        return Render(image, transmittance, depth_map)

    def begin(self, iteration: int) -> None:
        """Before an iteration (1-based): raise the SH degree if it is time."""
        self._iteration = iteration
        self.degree = self.budget.active_degree(iteration)

    def forget_views(self) -> None:
        """Drop the gradients that were gathered since the last step."""
        self._gradients = []

    def finish(self, iteration: int) -> None:
        """After the backward pass: density control, then Adam, which rests where parameters were just replaced."""
        parts, self._gradients = self._gradients, []
        change = self.density.update(self.optimizer, iteration, self._generator)
        if parts and not change.densified:
            gradients = Gradients.total(parts, len(self.state))
            self.optimizer.step(gradients, iteration, without="opacity_logits" if change.opacity_reset else None)
