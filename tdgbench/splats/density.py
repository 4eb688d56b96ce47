"""Adaptive density control of 3DGS (section 5): clone, split, prune, reset opacity.

Constants and order follow `train.py` and `gaussian_model.py` of 3DGS. One of its facts is easily missed: the call
that appends clones zeroes the screen radii, so its test "screen radius > 20 px" never removes anything.
`screen_radius_prune` chooses between that (false) and the test as it is described (true).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from tdgbench.splats.gaussians import Gaussians, concatenate
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.reference import rotation_matrices


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
    max_gaussians: int | None = None  # no growth beyond this


@dataclass
class DensityChange:
    """What one round did."""

    cloned: int = 0
    split: int = 0
    pruned: int = 0


class DensityControl:
    """Gathers gradients and radii view by view and changes the set of Gaussians when its rules say so."""

    def __init__(self, rules: DensityRules, extent: float, count: int) -> None:
        self.rules = rules
        self.extent = extent
        self._clear(count)

    def _clear(self, count: int) -> None:
        self.grad_sum = torch.zeros(count)
        self.seen = torch.zeros(count)
        self.max_radii = torch.zeros(count)

    @torch.no_grad()
    def observe(self, means2d_grad: Tensor, radii: Tensor, width: int, height: int) -> None:
        """Take in one backward pass: image gradients (N, 2) per px and screen radii (N,) in px."""
        scale = means2d_grad.new_tensor([0.5 * width, 0.5 * height])
        visible = radii > 0
        norm = (means2d_grad * scale).norm(dim=1)
        self.grad_sum += torch.where(visible, norm, 0.0)
        self.seen += visible
        self.max_radii = torch.maximum(self.max_radii, radii.to(self.max_radii))

    def is_active(self, iteration: int) -> bool:
        """Whether views are still observed at this iteration."""
        return iteration < self.rules.stop

    @torch.no_grad()
    def update(
        self, gaussians: Gaussians, optimizer: Adam, iteration: int, generator: torch.Generator
    ) -> tuple[Gaussians, DensityChange | None]:
        """Apply what is due at this iteration; returns the set to go on with, and what changed (None: nothing due)."""
        rules = self.rules
        change = None
        if not self.is_active(iteration):
            return gaussians, change
        if iteration > rules.start and iteration % rules.every == 0:
            gaussians, change = self._densify_and_prune(gaussians, optimizer, iteration, generator)
        if iteration % rules.opacity_reset_every == 0:
            ceiling = torch.tensor(rules.opacity_reset_to).logit().item()
            opacity_logits = gaussians.opacity_logits.detach().clamp_max(ceiling)
            gaussians = Gaussians(**{**dict(gaussians.items()), "opacity_logits": opacity_logits})
            gaussians.opacity_logits.requires_grad_()
            optimizer.forget("opacity_logits")
        return gaussians, change

    def _densify_and_prune(self, gaussians, optimizer, iteration, generator):
        rules, change = self.rules, DensityChange()
        old = gaussians.detach()
        grads = torch.nan_to_num(self.grad_sum / self.seen)
        small = old.scales.amax(dim=1) <= rules.clone_max_scale * self.extent
        hot = grads >= rules.grad_threshold
        if rules.max_gaussians is not None:
            hot = _hottest(hot, grads, rules.max_gaussians - len(old))
        clone, split = hot & small, hot & ~small
        clones = old.select(clone)
        children = self._children(old.select(split), generator)
        change.cloned, change.split = int(clone.sum()), int(split.sum())
        optimizer.append(concatenate([clones, children]))
        grown = concatenate([old, clones, children])

        remove = grown.opacities < rules.min_opacity
        remove[: len(old)] |= split
        if iteration > rules.opacity_reset_every:
            remove |= grown.scales.amax(dim=1) > rules.max_world_scale * self.extent
            if rules.screen_radius_prune:
                remove[: len(old)] |= self.max_radii > rules.max_screen_radius
        change.pruned = int(remove.sum()) - change.split
        keep = (~remove).nonzero().squeeze(1)
        optimizer.keep(keep)
        kept = grown.select(keep).as_leaves()
        self._clear(len(kept))
        return kept, change

    def _children(self, parents: Gaussians, generator: torch.Generator) -> Gaussians:
        """Smaller Gaussians drawn from inside each parent's own distribution."""
        n = self.rules.split_into
        many = parents.map(lambda t: t.repeat(n, *[1] * (t.dim() - 1)))
        offsets = torch.randn(len(many), 3, generator=generator).to(many.means) * many.scales
        rotated = (rotation_matrices(many.quats) @ offsets[..., None]).squeeze(-1)
        return Gaussians(
            means=many.means + rotated,
            log_scales=(many.scales / (self.rules.split_shrink * n)).log(),
            quats=many.quats,
            opacity_logits=many.opacity_logits,
            sh=many.sh,
        )


def _hottest(hot: Tensor, grads: Tensor, room: int) -> Tensor:
    """At most `room` of the marked Gaussians, those with the largest gradients."""
    if int(hot.sum()) <= room:
        return hot
    chosen = torch.zeros_like(hot)
    if room > 0:
        chosen[torch.where(hot, grads, -1.0).argsort(descending=True, stable=True)[:room]] = True
    return chosen
