"""A set of Gaussians in training: render it, let its density change, move it."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.density import DensityChange, DensityControl
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.render import render_state
from tdgbench.splats.state import TrainingState
from tdgbench.training.budget import Budget
from tdgbench.training.skips import Skips


@dataclass
class Work:
    """What the steps so far were about: sums over all backward passes."""

    rows: int = 0  # Gaussians
    touched: int = 0  # of them, with a gradient
    pairs: int = 0  # (tile, Gaussian) pairs listed
    blended: int = 0  # of them, looked at before their tile had ended
    cloned: int = 0  # Gaussians
    split: int = 0
    pruned: int = 0

    def add(self, gradients: Gradients, count: int) -> None:
        self.rows += count
        self.touched += sum(n for _, n in gradients.pieces)
        self.pairs += gradients.pairs
        self.blended += gradients.blended

    def add_change(self, change: DensityChange) -> None:
        self.cloned += change.cloned
        self.split += change.split
        self.pruned += change.pruned

    def density(self) -> dict[str, int]:
        """How many Gaussians density control cloned, split and pruned."""
        return {"cloned": self.cloned, "split": self.split, "pruned": self.pruned}


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
        self,
        gaussians: Gaussians,
        budget: Budget,
        extent: float,
        backend: str,
        generator: torch.Generator,
        skips: Skips | None = None,
    ) -> None:
        self.state = TrainingState(gaussians)
        self.budget = budget
        self.backend = backend
        self.degree = 0
        self.optimizer = Adam(self.state, budget.rates, extent)
        self.density = DensityControl(budget.density, extent, self.state, budget.iterations)
        self.skips = skips or Skips()
        self.work = Work()
        self._blending = replace(AS_3DGS, end_early=self.skips.saturated.allowed)
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

    def copy(self) -> Gaussians:
        """A copy of the Gaussians as they are now. Unlike `gaussians`, it leaves the model as it is to the last bit."""
        state, optimizer = copy.deepcopy((self.state, self.optimizer))
        optimizer.settle()
        return state.split(state.values)

    def render(self, camera: Camera, *, depth: bool = False) -> Render:
        """Render at the degree in use, colour and depth in one pass. With gradients it counts for density control."""
        size = (camera.width, camera.height)

        def collect(gradients: Gradients) -> None:
            self._gradients.append(gradients)
            self.work.add(gradients, len(self.state))
            if self.density.is_active(self._iteration):
                self.density.observe(gradients, *size)

        image, depth_map, transmittance = render_state(
            self.state, self.optimizer, camera.world_to_camera, camera.K, *size, degree=self.degree, depth=depth,
            iteration=self._iteration, backend=self.backend, collect=collect, blending=self._blending,
            skip_unseen=self.skips.unseen.allowed,
        )  # fmt: skip
        return Render(image, transmittance, depth_map)

    def state_dict(self) -> dict[str, Any]:
        """Everything that training changes, as `torch.save` takes it; between two iterations."""
        return {
            "rows": self.state.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "density": self.density.state_dict(),
            "degree": self.degree,
            "work": asdict(self.work),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take over what `state_dict` gave; the random stream is the context's."""
        self.state.load_state_dict(saved["rows"])
        self.optimizer.load_state_dict(saved["optimizer"])
        self.density.load_state_dict(saved["density"])
        self.degree = saved["degree"]
        self.work = Work(**saved["work"])

    def begin(self, iteration: int) -> None:
        """Before an iteration (1-based): raise the SH degree if it is time."""
        self._iteration = iteration
        if self.budget.active_degree(iteration) > self.budget.active_degree(iteration - 1):
            self.degree += 1

    def forget_views(self) -> None:
        """Drop the gradients that were gathered since the last step."""
        self._gradients = []

    def is_settled(self, iteration: int) -> bool:
        """Whether the model is worth saving at an iteration: it has recovered from its last density control."""
        return self.budget.density.is_settled(iteration, self.budget.iterations)

    def finish(self, iteration: int) -> str | None:
        """After the backward pass: density control, then Adam, which rests where parameters were just replaced.

        Returns the name of a parameter whose gradient is not finite, if there is one; Adam has then taken it in.
        """
        parts, self._gradients = self._gradients, []
        change = self.density.update(self.optimizer, iteration, self._generator)
        self.work.add_change(change)
        if parts and not change.densified:
            gradients = Gradients.total(parts, len(self.state))
            bad = self.optimizer.step(gradients, iteration, "opacity_logits" if change.opacity_reset else None)
            if not self.skips.unseen.allowed:
                self.optimizer.settle()
            return bad
        return None
