"""Adaptive density control of 3DGS (section 5): clone, split, prune, reset opacity.

Constants and order follow `train.py` and `gaussian_model.py` of 3DGS. There the call that appends clones zeroes the
screen radii, so that the test "screen radius > 20 px" never removes anything: `screen_radius_prune: false` does the
same, `true` applies the test as described.

3DGS tests the length of the summed gradient of a Gaussian's image mean, in which the pulls of different pixels on a
large Gaussian cancel. The absolute gradient of AbsGS (Ye et al. 2024) is the length of the sums of |d/du| and |d/dv|
over pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import torch
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from torch import Tensor

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.gradients import Gradients, GradientStatistics, PendingGradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState

GradientKind = Literal["signed", "absolute"]


@dataclass(frozen=True)
class DensityRules:
    """When and how the number of Gaussians changes. Iterations count from 1."""

    start: NonNegativeInt  # the first round is after this iteration
    stop: NonNegativeInt  # the last round is before this iteration
    every: PositiveInt  # iterations between rounds
    grad_threshold: NonNegativeFloat  # mean image-plane gradient of the centre, in units of half the image
    clone_max_scale: NonNegativeFloat  # × extent: smaller Gaussians are cloned, larger ones split
    split_into: PositiveInt
    split_shrink: PositiveFloat  # children's scale = parent's / (this × split_into)
    min_opacity: Annotated[float, Field(ge=0, lt=1)]
    max_world_scale: PositiveFloat  # × extent; larger ones are pruned after the first opacity reset
    max_screen_radius: NonNegativeInt  # px
    screen_radius_prune: bool
    opacity_reset_every: PositiveInt
    opacity_reset_to: Annotated[float, Field(gt=0, lt=1)]
    round_recovery: NonNegativeInt  # × every: no round in a training's last iterations; the model needs them to recover
    reset_recovery: NonNegativeInt  # × every: the same for opacity resets
    max_gaussians: PositiveInt | None = None  # no growth beyond this
    gradient: GradientKind = "signed"  # to which `grad_threshold` applies
    filled_at: NonNegativeInt | None = None  # iteration by which there are `max_gaussians`, whatever the threshold

    @property
    def uses_absolute(self) -> bool:
        """Whether growth depends on absolute gradients."""
        return self.gradient == "absolute"

    def is_round(self, iteration: int, iterations: int) -> bool:
        """Return whether a training clones, splits and prunes at an iteration. iterations: its length.

        >>> rules = DensityRules(
        ...     start=500, stop=15_000, every=100, grad_threshold=2e-4, clone_max_scale=0.01, split_into=2,
        ...     split_shrink=0.8, min_opacity=0.005, max_world_scale=0.1, max_screen_radius=20,
        ...     screen_radius_prune=False, opacity_reset_every=3000, opacity_reset_to=0.01, round_recovery=1,
        ...     reset_recovery=5,
        ... )
        >>> [rules.is_round(iteration, 10_000) for iteration in (500, 600, 650, 9_900, 10_000)]
        [False, True, False, True, False]
        """
        is_due = self.start < iteration < self.stop and iteration % self.every == 0
        return is_due and iterations - iteration >= self.round_recovery * self.every

    def is_reset(self, iteration: int, iterations: int) -> bool:
        """Return whether a training resets opacities at an iteration. iterations: its length."""
        is_due = 0 < iteration < self.stop and iteration % self.opacity_reset_every == 0
        return is_due and iterations - iteration >= self.reset_recovery * self.every

    def begin(self, gaussians: Gaussians) -> Gaussians:
        """Return the Gaussians of a training that begins from points, as `gaussians_from_points` makes them."""
        return gaussians

    def was_reset(self, iteration: int, iterations: int) -> bool:
        """Return whether the model at an iteration, before density control, has not recovered from a reset."""
        resets = range(max(1, iteration - self.reset_recovery * self.every + 1), iteration)
        return any(self.is_reset(i, iterations) for i in resets)

    def control(self, extent: float, state: TrainingState, iterations: int) -> DensityControl:
        """Return density control by these rules; see `DensityControl`."""
        return DensityControl(self, extent, state, iterations)

    def has_recovered(self, iteration: int, iterations: int) -> bool:
        """Return whether the model at an iteration, before density control, has recovered from all rounds and resets.

        Only such a model is worth saving: a reset costs more than 10 dB, a round some tenths.
        """
        rounds = range(max(1, iteration - self.round_recovery * self.every + 1), iteration)
        return not (any(self.is_round(i, iterations) for i in rounds) or self.was_reset(iteration, iterations))


@dataclass
class DensityChange:
    """Changes of the set of Gaussians in one iteration."""

    densified: bool = False  # a round of cloning, splitting and pruning took place
    opacity_reset: bool = False
    cloned: int = 0
    split: int = 0
    pruned: int = 0
    relocated: int = 0
    not_grown: int = 0  # above the gradient threshold, but rejected by another growth rule


class GrowthDecision(NamedTuple):
    """Which of N Gaussians grow, and which are pruned."""

    strength: Tensor  # (N,): if not all can grow, the strongest do
    grow: Tensor  # (N,) bool
    at_camera: Tensor  # (N,) bool: a camera stands in it


@dataclass
class TrainingView:
    """Gradients of a view of width × height px after its backward pass. label: of the render, for density control."""

    gradients: Gradients | PendingGradients
    width: int
    height: int
    label: str = ""


class DensityControl:
    """Accumulates gradients and radii over views, and changes the set of Gaussians by its rules."""

    opacity_fields: tuple[str, ...] = ("opacity_logits",)  # that a reset lowers
    accumulated: tuple[str, ...] = ("grad_sum", "view_counts", "max_radii", "absolute_sum")  # tensors, 0 after a round

    def __init__(self, rules: DensityRules, extent: float, state: TrainingState, iterations: int) -> None:
        """extent: of the scene, world units. iterations: length of the training."""
        self.rules, self.extent, self.state, self.iterations = rules, extent, state, iterations
        self._clear()

    def _clear(self) -> None:
        self.grad_sum, self.view_counts, self.max_radii = self.state.values.new_zeros(3, len(self.state))
        self.absolute_sum = self.grad_sum.new_zeros(len(self.state) if self.rules.uses_absolute else 0)

    def observe_visible(self, view: Gradients | PendingGradients) -> None:
        """Count a view for its visible Gaussians, and update their largest radii."""
        self.state.backend.observe_visible(view, self.view_counts, self.max_radii)

    def observe_gradients(self, gradients: Gradients, width: int, height: int) -> None:
        """Accumulate the gradients of a view of width × height px."""
        if self.rules.uses_absolute and gradients.image.shape[1] < 5:
            raise ValueError("these gradients lack the absolute ones: render the view with absgrad=True")
        self.state.backend.observe_gradients(gradients, self.statistics(width, height))

    def observe(self, views: Sequence[TrainingView]) -> None:
        """Accumulate the gradients of an iteration's views, which are computed."""
        for view in views:
            self.observe_gradients(view.gradients.compute(), view.width, view.height)

    def statistics(self, width: int, height: int) -> GradientStatistics:
        """Return where the gradients of a view of width × height px are accumulated."""
        return GradientStatistics(self.grad_sum, self.absolute_sum, 0.5 * width, 0.5 * height)

    def state_dict(self) -> dict[str, Tensor]:
        """Return the accumulated tensors, as `torch.save` takes them."""
        tensors = {name: getattr(self, name).cpu() for name in self.accumulated}
        return {name: tensor for name, tensor in tensors.items() if len(tensor)}

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Restore what `state_dict` returned, after the rows were restored."""
        self._clear()
        for name, tensor in saved.items():
            getattr(self, name).copy_(tensor)

    def is_active(self, iteration: int) -> bool:
        """Return whether density control still observes views at an iteration."""
        return iteration < self.rules.stop

    def is_due(self, iteration: int) -> bool:
        """Return whether `update` changes Gaussians at an iteration."""
        return self.is_round(iteration) or self._is_reset(iteration)

    def _is_reset(self, iteration: int) -> bool:
        """Return whether `update` resets opacities at an iteration."""
        return self.is_active(iteration) and self.rules.is_reset(iteration, self.iterations)

    def regularised(self, gradients: Gradients | PendingGradients) -> Gradients | PendingGradients:
        """Add the gradients of density control's own loss terms to those of an iteration; 3DGS has no such terms."""
        return gradients

    def after_step(self, optimizer: Adam, iteration: int, generator: torch.Generator) -> None:
        """Change Gaussians after the optimiser's step; 3DGS does not."""

    def is_round(self, iteration: int) -> bool:
        """Return whether `update` clones, splits and prunes at an iteration."""
        return self.is_active(iteration) and self.rules.is_round(iteration, self.iterations)

    def update(
        self, optimizer: Adam, iteration: int, generator: torch.Generator, decision: GrowthDecision | None = None
    ) -> DensityChange:
        """Clone, split, prune and reset opacities as due at an iteration; children's positions are random.

        decision: replaces the gradient threshold of 3DGS.
        """
        change = DensityChange()
        if not self.is_active(iteration):
            return change
        change.densified = self.is_round(iteration)
        change.opacity_reset = self._is_reset(iteration)
        if change.densified or change.opacity_reset:
            optimizer.flush()
        if change.densified:
            self.state.backend.free_memory()  # of renders: the new Gaussians need the memory
            removed, added = self.removed_and_added(change, iteration, generator, decision)
            self.state.replace_rows(removed, added)
            self._clear()
            self.state.backend.free_memory()
        if change.opacity_reset:
            logit = math.log(self.rules.opacity_reset_to / (1 - self.rules.opacity_reset_to))
            for name in self.opacity_fields:
                self.state.values[:, self.state.columns_of(name)].clamp_max_(logit)
                optimizer.reset_moments(name)
        return change

    def removed_and_added(
        self, change: DensityChange, iteration: int, generator: torch.Generator, decision: GrowthDecision | None
    ) -> tuple[Tensor, Tensor]:
        """Return rows to remove (n,), ascending, and rows to add (m, columns) in a round of density control."""
        rules, values = self.rules, self.state.values
        old = self.state.split(values)
        largest = old.log_scales.amax(dim=1).exp_()
        small = largest <= rules.clone_max_scale * self.extent
        by_gradients = self._by_gradients()
        decision = decision or by_gradients
        remove = self._is_transparent(old) | decision.at_camera
        if iteration > rules.opacity_reset_every:
            remove |= largest > rules.max_world_scale * self.extent
            if rules.screen_radius_prune:
                remove |= self.max_radii > rules.max_screen_radius
        grow = self._growing(decision, remove, iteration)
        change.not_grown = int((by_gradients.grow & ~grow).sum())
        clone, split = (grow & small).nonzero().squeeze(1), (grow & ~small).nonzero().squeeze(1)
        change.cloned, change.split = len(clone), len(split)

        change.pruned = int(remove.sum()) - int(remove[split].sum())
        remove[split] = True
        added = torch.cat([values[clone], self._children(values[split], generator)])
        new = self.state.split(added)
        drop = self._is_transparent(new)
        if iteration > rules.opacity_reset_every:
            drop |= new.log_scales.amax(dim=1).exp_() > rules.max_world_scale * self.extent
        change.pruned += int(drop.sum())
        return remove.nonzero().squeeze(1), added[~drop] if bool(drop.any()) else added

    def _growing(self, decision: GrowthDecision, remove: Tensor, iteration: int) -> Tensor:
        """Return which Gaussians (N,) a round clones or splits. remove: (N,) bool, which it prunes.

        Where their number is given, the strongest grow, also below the threshold: as many as are missing, in equal
        parts in the rounds that are left. Each adds one Gaussian, or as many as a split adds.
        """
        if self.rules.filled_at is None:
            grow = decision.grow & ~decision.at_camera
            return strongest(grow, decision.strength, self._quota(len(remove), iteration))
        return strongest(~remove, decision.strength, self._quota(int((~remove).sum()), iteration))

    def _quota(self, count: int, iteration: int) -> int:
        """Return how many Gaussians a round may add to so many: all that a limit leaves, or an equal part of these."""
        rules = self.rules
        if rules.max_gaussians is None:
            return 2 * count  # no more can be added
        missing, each = rules.max_gaussians - count, max(1, rules.split_into - 1)
        if rules.filled_at is None:
            return missing // each
        rounds = sum(self.is_round(later) for later in range(iteration, rules.filled_at + 1))
        return min(math.ceil(missing / each / max(rounds, 1)), missing // each)

    def _is_transparent(self, gaussians: Gaussians) -> Tensor:
        """Return which Gaussians (n,) a round prunes for their opacity."""
        return gaussians.opacities < self.rules.min_opacity

    def _by_gradients(self) -> GrowthDecision:
        """Apply the rule of 3DGS: a Gaussian grows if the mean gradient of its image position is large."""
        total = self.absolute_sum if self.rules.uses_absolute else self.grad_sum
        grads = torch.nan_to_num(total / self.view_counts)
        grow = grads >= self.rules.grad_threshold
        return GrowthDecision(grads, grow, torch.zeros_like(grow))

    def _children(self, parents: Tensor, generator: torch.Generator) -> Tensor:
        """Split parents (n, columns) into smaller Gaussians (split_into · n, columns), at positions drawn from them."""
        n = self.rules.split_into
        children = parents.repeat(n, 1)
        many = self.state.split(children)
        scales = many.scales
        offsets = torch.randn(len(children), 3, generator=generator).to(scales) * scales
        children[:, self.state.columns_of("means")] += (rotation_matrices(many.quats) @ offsets[..., None]).squeeze(-1)
        shrink = math.log(self.rules.split_shrink * n)  # of the logarithms: exp may underflow
        children[:, self.state.columns_of("log_scales")] -= shrink
        return children


def strongest(grow: Tensor, strength: Tensor, quota: int) -> Tensor:
    """Return at most `quota` of the marked Gaussians (N,), the strongest ones."""
    if int(grow.sum()) <= quota:
        return grow
    chosen = torch.zeros_like(grow)
    if quota > 0:
        chosen[torch.where(grow, strength, -1.0).argsort(descending=True, stable=True)[:quota]] = True
    return chosen
