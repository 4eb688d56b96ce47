"""The rule for growth: a Gaussian grows if its halves have significantly different residuals over several views.

A Gaussian that is split or cloned can have a value in each half. That helps where the residual has a contrast: its
means m₁ and m₂ in the halves differ. W₁ and W₂ are the sums of the blending weights w of the halves. In a view, the
contrast is D, to which noise of standard deviation σ in every pixel adds at most σ √W, since w ≤ 1:

    D = 2 W₁ W₂ / (W₁ + W₂) (m₁ − m₂),  W = 4 W₁ W₂ / (W₁ + W₂)

D, with its sign, and W are summed over views. A Gaussian may grow if its strength exceeds `z`: the root mean square of
D over the channels, divided by σ √W. Errors of single views have different signs and cancel in D. A residual that is
equal in both halves has no contrast, also where one half is hidden or beyond the image's edge: another value of the
whole Gaussian explains it, or the drift of a view. σ is the noise of full-size images. Smaller ones have less noise, so
that the test is stricter for them. The variance of D between views is no measure of noise: a model that lacks Gaussians
has as much of it.

Where images have little noise, nearly all Gaussians pass. A Gaussian that grows lowers the squared error by D² / W, its
gain. The strongest grow, as many as make up `share` of the gain of all that pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
import torch
from pydantic import Field, NonNegativeFloat, PositiveInt
from torch import Tensor

from tdgbench.scenes import View
from tdgbench.splats import Gaussians
from tdgbench.splats.backends.backend import SumFootprints
from tdgbench.splats.density import GrowthDecision, strongest
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.render import footprint_sums, render_view
from tdgbench.splats.view import GaussianTensors, Pinhole
from tdgbench.training.rule import DecideGrowth, ModelInputs, Rule
from tdgbench.training.skips import NO_GAUSSIANS, Finished, Skip, summed

_SLACK = 1e-3  # relative, of distances, against rounding
TINY = 1e-20  # px, below any weight
_FEWEST_VIEWS = 2  # in which a Gaussian must be visible; one view decides nothing
HALF = 0.6  # σ from a Gaussian's centre to those of its halves along its longest axis
NARROWER = (1 - HALF**2) ** 0.5  # σ of a half on that axis: both together have the Gaussian's second moment
FAINTER = 0.5 / NARROWER  # opacity of a half: both together have the Gaussian's mass


@dataclass(frozen=True)
class GrowthRule(Rule):
    """Let Gaussians grow where rendered training views show that they should, instead of by a gradient's threshold."""

    views: PositiveInt  # training views that a round renders
    z: NonNegativeFloat  # least contrast between the halves of a Gaussian that grows, standard deviations of noise
    share: Annotated[float, Field(gt=0, le=1)]  # of the gain of all that pass `z`; the strongest that make it up grow
    clearance: NonNegativeFloat  # standard deviations; a Gaussian whose centre is nearer to a camera is pruned

    def growth(self, model: ModelInputs) -> DecideGrowth:
        return GrowthTest(self, model).decide

    def warm_up(self, gaussians: Gaussians, camera: Pinhole, backend: str) -> None:
        black = gaussians.means.new_zeros(camera.height, camera.width, gaussians.channels)
        footprints(sums_of_halves(gaussians, backend), camera, black, None)

    def account(self, skip: Skip, training: Finished) -> None:
        not_grown = summed(training.work, "not_grown")
        grown = summed(training.work, "cloned") + summed(training.work, "split")
        reason = f"{grown} Gaussians grew, on evidence from up to {self.views} views a round"
        saved = f"{not_grown} times, growth of a Gaussian with a large gradient"
        skip.decide(not_grown > 0, reason if training.work else NO_GAUSSIANS, saved)


class GrowthTest:
    """Decides which Gaussians of a model grow, by a `GrowthRule`."""

    def __init__(self, rule: GrowthRule, model: ModelInputs) -> None:
        """A round renders some of the model's views that its curriculum uses, at the curriculum's resolution."""
        self.rule, self.model = rule, model

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the noise in the views' images, at full resolution."""
        return self.model.images.typical_noise(self.model.views)

    @torch.no_grad()
    def decide(self, gaussians: Gaussians, degree: int, round_number: int) -> GrowthDecision:
        """Return which Gaussians grow, by the round's views, and which go. degree: of the harmonics in use."""
        views, weight = gaussians.means.new_zeros(2, len(gaussians))
        difference = gaussians.means.new_zeros(len(gaussians), gaussians.channels)
        active, sum_halves = gaussians.activated(degree), sums_of_halves(gaussians, self.model.backend)
        for view in self.views_of_round(round_number):
            seen = self.measure(self.model.curriculum.at_resolution(view), active, sum_halves)
            views += seen.visible
            weight += seen.weight
            difference += seen.difference
        is_known = (views >= _FEWEST_VIEWS) & (weight > 0)
        gain = torch.where(is_known, difference.square().mean(dim=1) / weight, 0.0)
        strength = gain.sqrt() / self.noise
        grow = strength > self.rule.z
        grow = strongest(grow, gain, fewest(gain[grow], self.rule.share))
        return GrowthDecision(strength, grow, self.at_cameras(gaussians))

    def at_cameras(self, gaussians: Gaussians) -> Tensor:
        """Return which Gaussians (N,) have a training camera within `clearance` of their centre.

        Nothing can be where a camera stands; cameras of held-out views count as well. Cameras around such a Gaussian do
        not see it, because it lies before their near plane. A camera between them would see nothing else: the
        projection, which is linear at the Gaussian's centre, covers its image.
        """
        centers = np.stack([self.model.camera_of(view.camera).center for view in self.model.views])
        x, y, z = gaussians.means.T.contiguous()
        nearest = torch.full_like(x, torch.inf)  # squared; rows of three take five times as long as columns
        for u, v, w in centers.tolist():
            torch.minimum(nearest, (x - u).square() + (y - v).square() + (z - w).square(), out=nearest)
        reach = self.rule.clearance * gaussians.scales.amax(dim=1)
        close = (nearest.sqrt() <= (1 + _SLACK) * reach).nonzero().squeeze(1)
        offsets = torch.as_tensor(centers).to(gaussians.means) - gaussians.means[close, None]  # (n, V, 3)
        along = torch.einsum("nij,nvi->nvj", rotation_matrices(gaussians.quats[close]), offsets)
        found = torch.zeros_like(reach, dtype=torch.bool)
        found[close] = ((along / gaussians.scales[close, None]).norm(dim=2) < self.rule.clearance).any(dim=1)
        return found

    def views_of_round(self, round_number: int) -> list[View]:
        """Return the views of a round, evenly spread and shifted by one in every round."""
        views = [view for view in self.model.views if self.model.curriculum.shows(view)]
        count = min(self.rule.views, len(views))
        return [views[(round_number + i * len(views) // count) % len(views)] for i in range(count)]

    def measure(self, view: View, active: GaussianTensors, sum_halves: SumFootprints) -> Footprints:
        """Render a view and return the footprints of the Gaussians, and of their halves, in its residual."""
        model, camera = self.model, Pinhole.of(self.model.camera_of(view.camera)).to(active.means)
        image = render_view(active, camera, background=model.background, backend=model.backend).image
        target, valid = model.images.tensors_of(view, image.device)
        return footprints(sum_halves, camera, target - image, valid)


def fewest(gains: Tensor, share: float) -> int:
    """Return how many of the largest of some gains (N,) make up a share of their sum.

    >>> gains = torch.tensor([1.0, 5.0, 3.0, 1.0])
    >>> fewest(gains, 0.8), fewest(gains, 1.0)
    (2, 4)
    """
    if share == 1:  # however small some are beside the others
        return len(gains)
    made_up = gains.double().sort(descending=True).values.cumsum(0)
    return int((made_up < share * made_up[-1:]).sum()) + bool(len(gains))


class Footprints(NamedTuple):
    """Contrast between the halves of N Gaussians in one view of C channels, each pixel weighted as in the blend."""

    weight: Tensor  # (N,) W, px: that of both halves if these weigh the same, 0 where one is out of sight
    difference: Tensor  # (N, C) D, signed, image values × px
    visible: Tensor  # (N,) bool


@torch.no_grad()
def footprints(sum_halves: SumFootprints, camera: Pinhole, residual: Tensor, valid: Tensor | None) -> Footprints:
    """Return the footprints of Gaussians in a residual (H, W, C); pixels where `valid` (H, W) is false do not count.

    sum_halves: from `sums_of_halves` of the Gaussians.
    """
    counts = torch.ones_like(residual[..., :1]) if valid is None else valid[..., None].to(residual)
    known = residual if valid is None else torch.where(valid[..., None], residual, 0.0)  # NaN may be at masked pixels
    maps = torch.cat([counts, known], dim=-1)
    sums, radii = sum_halves(camera, maps)
    n = len(sums) // 2
    first, second = sums[:n], sums[n:]
    visible = (radii[:n] > 0) | (radii[n:] > 0)
    one, other = first[:, :1], second[:, :1]
    both = (one + other).clamp_min(TINY)
    difference = 2 * (other * first[:, 1:] - one * second[:, 1:]) / both
    return Footprints((4 * one * other / both).squeeze(1), difference, visible)


def sums_of_halves(gaussians: Gaussians, backend: str) -> SumFootprints:
    """Return a function that sums C + 1 maps over the footprints of the halves of Gaussians with C channels."""
    return footprint_sums(split_in_halves(gaussians), gaussians.channels + 1, backend)


def split_in_halves(gaussians: Gaussians) -> GaussianTensors:
    """Return the halves of N Gaussians along their longest axes, without colour: N first ones, then N second ones."""
    scales = gaussians.scales
    longest = scales.argmax(dim=1, keepdim=True)
    axes = rotation_matrices(gaussians.quats).gather(2, longest[:, None, :].expand(-1, 3, 1)).squeeze(2)
    offsets = HALF * scales.gather(1, longest) * axes
    narrow = scales.scatter(1, longest, NARROWER * scales.gather(1, longest))
    return GaussianTensors(
        torch.cat([gaussians.means + offsets, gaussians.means - offsets]),
        gaussians.quats.repeat(2, 1), narrow.repeat(2, 1), (FAINTER * gaussians.opacities).repeat(2),
        gaussians.means.new_zeros(0, 0),
    )  # fmt: skip
