"""Adaptive density control of 3DGS (section 5): clone, split, prune, reset opacity.

Constants and order follow `train.py` and `gaussian_model.py` of 3DGS. One of its facts is easily missed: the call
that appends clones zeroes the screen radii, so its test "screen radius > 20 px" never removes anything.
`screen_radius_prune` chooses between that (false) and the test as it is described (true).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from tdgbench.splats.backends.reference import rotation_matrices
from tdgbench.splats.columns import MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.statistics import observe_gradients, observe_seen
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState


@dataclass(frozen=True)
class DensityRules:
    """When and how the number of Gaussians changes. Iterations count from 1."""

    start: int  # densify after this iteration
    stop: int  # and before this one
    every: int
    grad_threshold: float  # mean image-plane gradient of the centre, in units of half the image
    clone_max_scale: float  # × extent: smaller ones are cloned, larger ones split
    split_into: int
    split_shrink: float  # children's scale = parent's / (this × split_into)
    min_opacity: float
    max_world_scale: float  # × extent; larger ones are pruned after the first opacity reset
    max_screen_radius: int  # px
    screen_radius_prune: bool
    opacity_reset_every: int
    opacity_reset_to: float
    round_recovery: int  # × every: iterations that must follow a round of cloning, splitting and pruning
    reset_recovery: int  # × every: and an opacity reset; what would come later in a training is left out
    max_gaussians: int | None = None  # no growth beyond this

    def is_round(self, iteration: int, iterations: int) -> bool:
        """Whether Gaussians are cloned, split and pruned at an iteration of a training of so many."""
        on_time = self.start < iteration < self.stop and iteration % self.every == 0
        return on_time and iterations - iteration >= self.round_recovery * self.every

    def is_reset(self, iteration: int, iterations: int) -> bool:
        """Whether opacities are reset at an iteration of a training of so many."""
        on_time = 0 < iteration < self.stop and iteration % self.opacity_reset_every == 0
        return on_time and iterations - iteration >= self.reset_recovery * self.every

    def is_settled(self, iteration: int, iterations: int) -> bool:
        """Whether the model before this iteration's density control has recovered from all earlier rounds and resets.

        Only such a model is worth saving: a reset costs more than 10 dB, a round some tenths.
        """
        rounds = range(max(1, iteration - self.round_recovery * self.every + 1), iteration)
        resets = range(max(1, iteration - self.reset_recovery * self.every + 1), iteration)
        return not (
            any(self.is_round(i, iterations) for i in rounds) or any(self.is_reset(i, iterations) for i in resets)
        )


@dataclass
class DensityChange:
    """What one iteration did to the set of Gaussians."""

    densified: bool = False  # a round of cloning, splitting and pruning took place
    opacity_reset: bool = False
    cloned: int = 0
    split: int = 0
    pruned: int = 0


class DensityControl:
    """Gathers gradients and radii view by view and changes the set of Gaussians when its rules say so."""

    def __init__(self, rules: DensityRules, extent: float, state: TrainingState, iterations: int) -> None:
        """extent: of the scene, in world units. iterations: length of the training, which its end depends on."""
        self.rules, self.extent, self.state, self.iterations = rules, extent, state, iterations
        self._clear()

    def _clear(self) -> None:
        self.grad_sum, self.seen, self.max_radii = self.state.values.new_zeros(3, len(self.state))

    @torch.no_grad()
    def observe(self, gradients: Gradients, width: int, height: int) -> None:
        """Take in one backward pass of a view of width × height px."""
        half = (0.5 * width, 0.5 * height)
        if self.grad_sum.device.type == "cpu" and self.grad_sum.dtype == torch.float32:
            seen = (gradients.seen.numpy(), gradients.radii.numpy(), self.seen.numpy(), self.max_radii.numpy())
            pool.run(observe_seen, [(*piece, *seen) for piece in gradients.seen_pieces])
            pulls = (gradients.index.numpy(), gradients.image.numpy(), *half, self.grad_sum.numpy())
            pool.run(observe_gradients, [(*piece, *pulls) for piece in gradients.pieces])
            return
        index, radii = gradients.visible()
        self.seen[index] += 1
        self.max_radii[index] = torch.maximum(self.max_radii[index], radii.to(self.max_radii))
        index, _, image = gradients.rows()
        norm = (image[:, :2] * image.new_tensor(half)).norm(dim=1)
        self.grad_sum.index_add_(0, index, torch.where(image[:, 2] > 0, norm, 0.0))

    def state_dict(self) -> dict[str, Tensor]:
        """What was gathered since the last change, as `torch.save` takes it."""
        return {"grad_sum": self.grad_sum.cpu(), "seen": self.seen.cpu(), "max_radii": self.max_radii.cpu()}

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Take over what `state_dict` gave, once the rows are those of then."""
        self._clear()
        for name, tensor in saved.items():
            getattr(self, name).copy_(tensor)

    def is_active(self, iteration: int) -> bool:
        """Whether views are still observed at this iteration."""
        return iteration < self.rules.stop

    @torch.no_grad()
    def update(self, optimizer: Adam, iteration: int, generator: torch.Generator) -> DensityChange:
        """Apply what is due at this iteration."""
        rules, change = self.rules, DensityChange()
        if not self.is_active(iteration):
            return change
        change.densified = rules.is_round(iteration, self.iterations)
        change.opacity_reset = rules.is_reset(iteration, self.iterations)
        if change.densified or change.opacity_reset:
            optimizer.settle()
        if change.densified:
            self._densify_and_prune(change, iteration, generator)
        if change.opacity_reset:
            ceiling = math.log(rules.opacity_reset_to / (1 - rules.opacity_reset_to))
            self.state.values[:, self.state.column_of("opacity_logits")].clamp_max_(ceiling)
            optimizer.forget("opacity_logits")
        return change

    def _densify_and_prune(self, change: DensityChange, iteration: int, generator: torch.Generator) -> None:
        rules, values = self.rules, self.state.values
        old = self.state.split(values)
        grads = torch.nan_to_num(self.grad_sum / self.seen)
        largest = old.log_scales.amax(dim=1).exp_()
        small = largest <= rules.clone_max_scale * self.extent
        hot = grads >= rules.grad_threshold
        if rules.max_gaussians is not None:
            hot = _hottest(hot, grads, rules.max_gaussians - len(old))
        clone, split = (hot & small).nonzero().squeeze(1), (hot & ~small).nonzero().squeeze(1)
        change.cloned, change.split = len(clone), len(split)

        remove = old.opacities < rules.min_opacity
        if iteration > rules.opacity_reset_every:
            remove |= largest > rules.max_world_scale * self.extent
            if rules.screen_radius_prune:
                remove |= self.max_radii > rules.max_screen_radius
        change.pruned = int(remove.sum()) - int(remove[split].sum())
        remove[split] = True
        added = torch.cat([values[clone], self._children(values[split], generator)])
        new = self.state.split(added)
        drop = new.opacities < rules.min_opacity
        if iteration > rules.opacity_reset_every:
            drop |= new.log_scales.amax(dim=1).exp_() > rules.max_world_scale * self.extent
        change.pruned += int(drop.sum())
        self.state.exchange(remove.nonzero().squeeze(1), added[~drop])
        self._clear()

    def _children(self, parents: Tensor, generator: torch.Generator) -> Tensor:
        """Smaller Gaussians drawn from inside each parent's own distribution; rows (n, columns) in and out."""
        n = self.rules.split_into
        children = parents.repeat(n, 1)
        many = self.state.split(children)
        scales = many.scales
        offsets = torch.randn(len(children), 3, generator=generator).to(scales) * scales
        children[:, MEANS_AT:QUATS_AT] += (rotation_matrices(many.quats) @ offsets[..., None]).squeeze(-1)
        children[:, SCALES_AT:OPACITY_AT] -= math.log(self.rules.split_shrink * n)  # no exp: it may underflow
        return children


def _hottest(hot: Tensor, grads: Tensor, room: int) -> Tensor:
    """At most `room` of the marked Gaussians, those with the largest gradients."""
    if int(hot.sum()) <= room:
        return hot
    chosen = torch.zeros_like(hot)
    if room > 0:
        chosen[torch.where(hot, grads, -1.0).argsort(descending=True, stable=True)[:room]] = True
    return chosen
