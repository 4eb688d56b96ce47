"""Rules of growth that `benchmarks.growth` measures against that of `tdgbench.training.growth`.

They differ in what grows. What is pruned for its weight, and how Gaussians are cloned and split, is the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt
from torch import Tensor

from benchmarks.evidence.fragments import Fragments, compile_kernel, fragments
from tdgbench.scenes import View
from tdgbench.scenes.scene import extent_of
from tdgbench.splats import Gaussians
from tdgbench.splats.backends import load_backend
from tdgbench.splats.density import Verdict
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole
from tdgbench.training.evidence import Footprints
from tdgbench.training.growth import FEWEST_VIEWS, GrowthRule, Significance
from tdgbench.training.losses import photometric

ROUNDS = 10_000  # more than a training has
LAMBDA_DSSIM = 0.2  # of the loss of 3DGS, FastGS and LiteGS, whose gradients are taken


class _Residual(Significance):
    def look(self, view: View, gaussians: Gaussians, degree: int) -> Footprints:
        seen = super().look(view, gaussians, degree)
        return seen._replace(difference=seen.residual)


class _OfFragments(Significance):
    """Decides by sums over fragments of the views of a round, on the CPU."""

    def __init__(self, *given) -> None:
        super().__init__(*given)
        if load_backend(self.backend).device != "cpu":
            raise ValueError(f"fragments are summed on the CPU, not for backend={self.backend}; set backend=cpu")
        compile_kernel()  # now, so that training does not pay for it

    def looks(self, gaussians: Gaussians, degree: int, turn: int) -> Iterator[tuple[View, Fragments]]:
        """The views of a round, at the resolution of the iteration, with the fragments in them."""
        for chosen in self.chosen(turn):
            view = self.curriculum.at_resolution(chosen)
            camera, active = Pinhole.of(view.camera).to(gaussians.means), gaussians.activated(degree)
            image = render_view(active, camera, background=self.background, backend=self.backend).image
            target, valid = self.modality.tensor(view, image.device), self.modality.mask(view, image.device)
            with torch.enable_grad():
                photometric(image.requires_grad_(), target, LAMBDA_DSSIM, valid).backward()
            assert image.grad is not None
            error = (image.detach() - target).abs().mean(dim=2)
            yield view, fragments(active, camera, image, image.grad, self.is_high(error, valid), valid)

    def is_high(self, error: Tensor, valid: Tensor | None) -> Tensor:
        """(H, W) bool: the pixels that count, by their absolute error (H, W)."""
        return torch.zeros_like(error, dtype=torch.bool)


class _Count(_OfFragments):
    rule: CountRule

    def is_high(self, error: Tensor, valid: Tensor | None) -> Tensor:
        known = error if valid is None else error[valid]
        low, top = known.min(), known.max()
        high = error > (low + self.rule.share * (top - low)).clamp_min(self.rule.z * self.noise)
        return high if valid is None else high & valid

    @torch.no_grad()
    def judge(self, gaussians: Gaussians, degree: int, turn: int) -> Verdict:
        views, weight, high, gradient, absolute = gaussians.means.new_zeros(5, len(gaussians))
        looks = 0
        for view, seen in self.looks(gaussians, degree, turn):
            half = seen.centre.new_tensor((0.5 * view.camera.width, 0.5 * view.camera.height))
            views += seen.count > 0
            weight += seen.weight
            high += seen.high
            gradient += (half * seen.centre).norm(dim=1)
            absolute += (half * seen.centre_parts).norm(dim=1)
            looks += 1
        shown = views.clamp_min(1)
        is_small = gaussians.scales.amax(dim=1) <= self.rule.clone_max_scale * extent_of(self.views)
        is_hot = torch.where(
            is_small, gradient / shown >= self.rule.gradient, absolute / shown >= self.rule.absolute_gradient
        )
        grow = is_hot & ((high / looks).floor() > self.rule.pixels)
        return Verdict(high / looks, grow, self.useless(views, weight))


class _Opacity(_OfFragments):
    rule: OpacityRule

    @torch.no_grad()
    def judge(self, gaussians: Gaussians, degree: int, turn: int) -> Verdict:
        views, weight, count, total, squares = gaussians.means.new_zeros(5, len(gaussians))
        for _, seen in self.looks(gaussians, degree, turn):
            views += seen.count > 0
            weight += seen.weight
            count += seen.count
            total += seen.opacity
            squares += seen.opacity_squares
        variance = squares / (count + 1) - (total / (count + 1)).square()  # as `get_var` in `statistic_helper.py`
        useless = self.useless(views, weight)
        score = variance.clamp_min(0) * count * gaussians.opacities.square()
        score = torch.where(useless | (views < FEWEST_VIEWS), 0.0, score)
        grow = torch.zeros_like(useless)
        grow[self._drawn(score, turn, int(useless.sum()))] = True
        return Verdict(score, grow, useless)

    def _drawn(self, score: Tensor, turn: int, pruned: int) -> Tensor:
        """Indices of the Gaussians that grow in a round, drawn by their scores (N,)."""
        if turn >= self.rule.last or not bool((score > 0).any()):
            return score.new_zeros(0, dtype=torch.long)
        due = max(math.ceil((self.rule.target - len(score)) / (self.rule.last - turn)), 1) + pruned
        generator = torch.Generator().manual_seed(ROUNDS * self.rule.seed + turn)
        return torch.multinomial(score, min(due, int((score > 0).sum())), generator=generator)


@dataclass(frozen=True)
class ResidualRule(GrowthRule):
    """A Gaussian grows by the signed residual under its whole footprint.

    |Σ_views Σ_pixels w r| > z σ √(Σ w), as the difference of the halves in `tdgbench.training.growth`. This sum is also
    what another colour of the Gaussian would explain, without any growth.
    """

    significance = _Residual


@dataclass(frozen=True)
class CountRule(GrowthRule):
    """FastGS's densification (Ren et al. 2025, arXiv:2511.04283; fastgs/FastGS 44e02a5), with a floor for noise.

    A pixel counts if its absolute error e, the mean over the channels, has (e − min e) / (max e − min e) > `share` in
    its view, as in `utils/fast_utils.py`, and here also e > z σ of the images' noise. A Gaussian grows if the pixels
    that count among its fragments are more than `pixels` in the mean over all views looked at, rounded down, and the
    gradient of its centre in the image is large (`densify_and_prune_fastgs`): of those that are to be cloned the
    gradient's length, of those that are to be split the length of the sums of absolute values (AbsGS). Gradients are in
    units of half the image, means over the views looked at; FastGS takes those of the iterations since the last round.
    Pixels are those of the images at the resolution of the iteration.
    """

    share: NonNegativeFloat = 0.1  # arguments/__init__.py, `loss_thresh`
    pixels: NonNegativeFloat = 5.0
    gradient: NonNegativeFloat = 2e-4  # `grad_thresh`
    absolute_gradient: NonNegativeFloat = 1.2e-3  # `grad_abs_thresh`
    clone_max_scale: NonNegativeFloat = 0.01  # × extent: that of the budget, so that the density control agrees

    significance = _Count


@dataclass(frozen=True)
class OpacityRule(GrowthRule):
    """LiteGS's densification (Liao et al. 2025, arXiv:2503.01199; MooreThreads/LiteGS 004b952).

    A fragment's part in ∂L/∂opacity has a variance over all fragments of all views looked at. The score is variance ×
    number of fragments × opacity², and those that grow are drawn by it without replacement (`get_score`,
    `split_and_clone` in `training/densify.py`). Their number rises linearly to `target` Gaussians in the round `last`;
    it is at least 1, and what is pruned for its weight is replaced. LiteGS sums the squares in its kernel over running
    sums of the pixels of a thread; here they are those of single pixels. `z` has no part in it.
    """

    target: PositiveInt = 1_000_000  # arguments.py, `target_primitives`
    last: PositiveInt = 24  # round in iteration 2400: 0.8 of `budget.expected_iterations`, as `densify_until`
    seed: NonNegativeInt = 0  # of the draws

    significance = _Opacity
