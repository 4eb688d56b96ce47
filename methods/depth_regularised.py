"""Depth-regularised Gaussian splatting for few images (Chung et al. 2024), with thermal images and the depth prior.

Depth priors are aligned to sparse points, view by view (`methods.aligned_depth`). The authors take depth and edges of
RGB images; here, both are those of thermal images. Constants and order: robot0321/DepthRegularizedGS, commit c95ab50d.
Its rasteriser has lost the normalisation of depth and part of its gradient; the authors advise that of their first
commits (8fc8495), whose depth is Σ z α T / Σ α T with the gradients of both sums: so it is here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt
from torch import Tensor
from torch.nn import functional as F

from methods.aligned_depth import metric_depths
from methods.canny import canny
from tdgbench.priors import DepthPrior
from tdgbench.scenes import View
from tdgbench.splats.density import DensityRules
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.images import THERMAL
from tdgbench.training.losses import photometric
from tdgbench.training.method import Method, Share, Step
from tdgbench.training.part import Stopping

EPSILON = 1e-8
EDGES = 50, 150  # Canny's thresholds, of images from 0 to 255: cameras.py, line 41
OLD_SHARE = 0.8  # of the smoothed loss: train.py, line 130
FIRST_LOSS = 100.0  # line 58


@dataclass
class DepthRegularised(Method):
    """L = (1 − λ_ssim) L1 + λ_ssim (1 − SSIM) + λ_depth mean |D_prior − D| + λ_smooth mean (D̄ − D)²."""

    lambda_ssim: Share
    lambda_depth: NonNegativeFloat
    lambda_smooth: NonNegativeFloat
    sh_degree: NonNegativeInt  # at most
    opacity_resets: bool
    densify_from: NonNegativeInt | None  # iteration; None: as the budget
    max_gaussians: PositiveInt | None
    stop_after: NonNegativeInt | None  # iteration after which training ends once the smoothed depth loss rises from
    stop_every: PositiveInt  # one multiple of this to the next; None: it does not
    occlusion: NonNegativeFloat | None  # see `metric_depths`

    def __post_init__(self) -> None:
        self.needs_prior = self.lambda_depth > 0

    @property
    def loss_takes_depth(self) -> bool:
        return True

    def setup(self, context: Context) -> None:
        budget = context.budget
        degree = min(budget.sh_degree, self.sh_degree)
        self.model = context.gaussians(budget=replace(budget, sh_degree=degree, density=self._density(budget.density)))
        self.views = context.views()
        depths = dict[str, DepthPrior]() if self.needs_prior else None
        if context.priors:  # there are none where a training is looked at from outside
            depths = metric_depths(context.scene, context.priors, self.occlusion)
        self.targets = Targets(depths, context.device)
        self.rise = None
        if self.needs_prior and self.stop_after is not None:
            self.rise = context.add_part("depth_loss", Rise(self.stop_after, self.stop_every))

    def _density(self, rules: DensityRules) -> DensityRules:
        """Return the density control of 3DGS as the authors have it; another one stays as it is."""
        if type(rules) is not DensityRules:
            return rules
        start = rules.start if self.densify_from is None else self.densify_from
        most = min((n for n in (rules.max_gaussians, self.max_gaussians) if n is not None), default=None)
        rules = replace(rules, start=start, max_gaussians=most)
        return rules if self.opacity_resets else WithoutResets(**vars(rules))

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.model.render(view.camera, depth=True)
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = photometric(render.image, target, self.lambda_ssim, valid)
        terms = {"thermal": loss}
        prior, known, flat = self.targets.for_view(view)
        depth = expected_depth(render)
        terms["smooth"] = depth_smoothness(depth, flat, valid)
        if self.needs_prior:
            terms["depth"] = self.lambda_depth * prior_loss(depth, prior, known, valid)
            loss = loss + terms["depth"]
        if self.rise is not None:
            self.rise.note(terms["depth"].item())
        return Step(loss + self.lambda_smooth * terms["smooth"], terms, render, target, valid)


@dataclass(frozen=True)
class WithoutResets(DensityRules):
    """Density control without opacity resets; `opacity_reset_every` still says when large Gaussians are pruned."""

    def is_reset(self, iteration: int, iterations: int) -> bool:
        return False


class Rise(Stopping):
    """Ends a training once a smoothed loss rises (train.py, lines 130 to 143)."""

    changing = ("_smoothed", "_before", "_risen_at")

    def __init__(self, after: int, every: int) -> None:
        self.after, self.every = after, every
        self._smoothed, self._before, self._risen_at = 0.0, FIRST_LOSS, 0

    def note(self, loss: float) -> None:
        """Take the loss of an iteration."""
        self._smoothed = (1 - OLD_SHARE) * loss + OLD_SHARE * self._smoothed

    def reached(self, iteration: int, loss: float) -> bool:
        if iteration % self.every == 0 and not self._risen_at:
            if iteration > self.after and self._smoothed > self._before:
                self._risen_at = iteration
            self._before = self._smoothed
        return bool(self._risen_at)

    def report(self) -> dict[str, Any]:
        return {"rose_at": self._risen_at} if self._risen_at else {}


class Targets:
    """Prior, where it is positive, and the image's pixels without edges, by view, in the size of its image."""

    def __init__(self, depths: dict[str, DepthPrior] | None, device: torch.device) -> None:
        """depths: metric priors by view; None: no prior is known anywhere."""
        self._depths, self._device = depths, device
        self._of: dict[str, tuple[Tensor, Tensor, Tensor]] = {}

    def for_view(self, view: View) -> tuple[Tensor, Tensor, Tensor]:
        """Return depth (H, W), world units, 0 where unknown; where it is known, and no edges, bool (H, W)."""
        size = (view.camera.height, view.camera.width)
        if view.name not in self._of or self._of[view.name][0].shape != size:
            depths = self._depths
            values = np.zeros(size, np.float32) if depths is None else depths[view.name].of_view(view).values
            known = np.isfinite(values) & (values > 0)
            flat = ~canny((view.thermal * 255).astype(np.uint8), *EDGES)
            arrays = (np.where(known, values, np.float32(0)), known, flat)
            found = [torch.from_numpy(array).to(self._device) for array in arrays]
            self._of[view.name] = (found[0], found[1], found[2])
        return self._of[view.name]


def expected_depth(render: Render) -> Tensor:
    """Return the expected z (H, W), world units: accumulated z / alpha; 0 where there are no Gaussians."""
    return render.requested_depth / (render.alpha + EPSILON)


def prior_loss(depth: Tensor, prior: Tensor, known: Tensor, valid: Tensor | None = None) -> Tensor:
    """Return |prior − depth| where the prior is known, summed and divided by the number of valid pixels; (H, W)."""
    count = depth.numel() if valid is None else int(valid.sum())
    return torch.where(known, (prior - depth).abs(), 0.0).sum() / count


def depth_smoothness(depth: Tensor, flat: Tensor, valid: Tensor | None = None) -> Tensor:
    """Return the mean of (D̄ − D)² over valid pixels; depth (H, W). flat: bool (H, W), where the image has no edges.

    D̄ is the mean of the pixel and its 4 neighbours, of those that are flat, valid and have a depth; 0 if there is none.
    """
    has_depth = (depth > 0).detach()
    counted = flat & has_depth if valid is None else flat & has_depth & valid
    error = neighbour_mean(depth, counted.to(depth)) - depth * has_depth
    return error.square().mean() if valid is None else error[valid].square().mean()


def neighbour_mean(values: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted mean of each pixel and its 4 neighbours inside the image; maps (H, W)."""
    plus = values.new_tensor([[0.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 1.0, 0.0]])[None, None]
    sums, counts = (F.conv2d(part[None, None], plus, padding=1)[0, 0] for part in (values * weights, weights))
    return sums / (counts + EPSILON)
