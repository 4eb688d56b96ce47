"""SAD-GS: 3DGS from depth, with Gaussians of its voxels and a loss on those in front of and behind its surfaces.

Constants and order are those of umautobots/SAD-GS, commit f9055f74, with the options of its full method
(demo_run_batch_replica.py). That is for RGB-D images of rooms, with depth in metres. Here, images are thermal, depth is
the prior's, and scenes have no unit: a metric prior is taken as it is, another one is aligned to sparse points
(`methods.aligned_depth`), and a metre is a share of the cameras' extent, which is a choice of this project.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from torch import Tensor

from methods.aligned_depth import metric_depths
from methods.voxels import voxel_gaussians
from tdgbench.priors import DepthPrior
from tdgbench.scenes import Scene, View
from tdgbench.splats import Gaussians
from tdgbench.splats.backends.reference import rotation_matrices
from tdgbench.splats.density import DensityChange, DensityControl, DensityRules, GrowthDecision
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import GaussianTensors, Pinhole
from tdgbench.training.context import Context
from tdgbench.training.images import THERMAL
from tdgbench.training.losses import photometric
from tdgbench.training.method import Method, Share, Step
from tdgbench.training.part import Part


@dataclass
class SADGS(Method):
    """L = λ_image ((1 − λ_ssim) L1 + λ_ssim (1 − SSIM)) + L_free."""

    needs_prior = True

    lambda_ssim: Share
    lambda_image: NonNegativeFloat
    metre: PositiveFloat  # × extent
    voxel: PositiveFloat  # its side, metres
    reach: PositiveFloat  # of free points, from the surface, metres
    jitter: NonNegativeFloat  # of reach, at most, metres
    drawn: Share  # free points, a share of a view's pixels
    cube: PositiveFloat  # its side, metres; Gaussians act on points in the same one
    blur: NonNegativeFloat  # metres², added to covariances
    tolerance: NonNegativeFloat  # of support, metres
    fade: Annotated[float, Field(gt=0, le=1)]  # factor of opacities without support
    fade_every: PositiveInt
    densify_from: NonNegativeInt | None  # iteration; None: as the budget
    reset_every: PositiveInt | None  # iterations; None: as the budget
    occlusion: NonNegativeFloat | None  # see `metric_depths`

    def setup(self, context: Context) -> None:
        self.unit = self.metre * context.scene.extent
        depths = metric_depths(context.scene, context.priors, self.occlusion)
        self.surfaces = Surfaces(context.scene, depths, context.device)
        context.add_part("surfaces", self.surfaces)
        self.surfaces.facts["metre"] = self.unit
        budget = replace(context.budget, density=self._density(context.budget.density))
        start = voxel_gaussians(*self.surfaces.points(), self.voxel * self.unit, budget.sh_degree)
        self.model, self.views = context.gaussians(start=start, budget=budget), context.views()
        self.draws, self.last = context.random("free_points"), context.budget.iterations

    def _density(self, rules: DensityRules) -> DensityRules:
        """Return the density control of 3DGS with fading; another one stays as it is, without."""
        if type(rules) is not DensityRules:
            return rules
        start = rules.start if self.densify_from is None else self.densify_from
        every = rules.opacity_reset_every if self.reset_every is None else self.reset_every
        given = {**vars(rules), "start": start, "opacity_reset_every": every}
        supported = partial(self.surfaces.support, tolerance=self.tolerance * self.unit)
        return SupportRules(**given, fade=self.fade, fade_every=self.fade_every, supported=supported)

    def step(self, iteration: int) -> Step:
        view, free = self.views.next(), []

        def hook(gaussians: Gaussians, degree: int) -> GaussianTensors:
            free.append(self._free(gaussians, view))
            return gaussians.activated(degree)

        render = self.model.render(view.camera, hook=hook)
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = photometric(render.image, target, self.lambda_ssim, valid)
        terms = {"thermal": loss, "free": free[0]}
        density = self.model.density
        if iteration == self.last and isinstance(density, SupportControl) and density.fades(iteration):
            self.model.optimizer.flush()  # as released, also before the last model is saved; no step follows
            density.fade_unsupported(self.model.optimizer)
        return Step(self.lambda_image * loss + free[0], terms, render, target, valid)

    def _free(self, gaussians: Gaussians, view: View) -> Tensor:
        """Return the mean density at free points of a view, which are drawn."""
        points = self.surfaces.free_points(
            view, self.drawn, self.reach * self.unit, self.jitter * self.unit, self.draws
        )
        turned = rotation_matrices(gaussians.quats) * gaussians.scales[:, None, :]
        blur = self.blur * self.unit**2 * torch.eye(3).to(turned)
        covariances = turned @ turned.transpose(1, 2) + blur
        return free_loss(points, gaussians.means, covariances, gaussians.opacities, self.cube * self.unit)


@dataclass(frozen=True, kw_only=True)
class SupportRules(DensityRules):
    """Rules of 3DGS, and opacities that fade where no training view has a surface."""

    fade: float
    fade_every: int
    supported: Callable[[Tensor], Tensor]  # of means (N, 3): which are near a surface (N,)

    def control(self, extent: float, state: TrainingState, iterations: int) -> SupportControl:
        return SupportControl(self, extent, state, iterations)


class SupportControl(DensityControl):
    """Lets Gaussians without support fade, before it clones, splits and prunes (train.py, lines 298 to 315)."""

    rules: SupportRules

    def fades(self, iteration: int) -> bool:
        """Return whether opacities fade at an iteration."""
        return self.is_active(iteration) and iteration % self.rules.fade_every == 0

    def is_due(self, iteration: int) -> bool:
        return self.fades(iteration) or super().is_due(iteration)

    @torch.no_grad()
    def update(
        self, optimizer: Adam, iteration: int, generator: torch.Generator, decision: GrowthDecision | None = None
    ) -> DensityChange:
        fades = self.fades(iteration)
        if fades:
            optimizer.flush()
            self.fade_unsupported(optimizer)
        change = super().update(optimizer, iteration, generator, decision)
        change.opacity_reset |= fades  # no step for opacities follows
        return change

    @torch.no_grad()
    def fade_unsupported(self, optimizer: Adam) -> None:
        """Multiply opacities without support, and forget the moments of all; `flush` first."""
        many = self.state.split(self.state.values)
        logits = many.opacity_logits
        faded = (self.rules.fade * many.opacities).clamp_min(torch.finfo(logits.dtype).tiny).logit()
        logits.copy_(torch.where(self.rules.supported(many.means), logits, torch.minimum(faded, logits)))
        optimizer.reset_moments("opacity_logits")


class Surfaces(Part):
    """Depth maps of the training views."""

    def __init__(self, scene: Scene, depths: dict[str, DepthPrior], device: torch.device) -> None:
        """depths: z in world units by view, NaN or not positive where unknown."""
        self.views = scene.train
        self.maps, self.known = {}, {}
        for view in scene.train:
            values = torch.from_numpy(depths[view.name].values).to(device)
            known = torch.isfinite(values) & (values > 0)
            self.maps[view.name] = torch.where(known, values, torch.nan)
            self.known[view.name] = known.flatten().nonzero().squeeze(1)
        self.cameras = {view.name: Pinhole.of(view.camera) for view in scene.train}
        self.facts: dict[str, Any] = {"pixels": sum(len(known) for known in self.known.values())}

    def report(self) -> dict[str, Any]:
        """Return the pixels with depth, and a metre in world units."""
        return self.facts

    def _at(self, view: View, pixels: Tensor) -> Tensor:
        """Return the points (n, 3) at pixels (n,), counted row by row, of a view."""
        depth, camera = self.maps[view.name], self.cameras[view.name].to(self.maps[view.name])
        x, y = pixels % camera.width + 0.5, pixels.div(camera.width, rounding_mode="floor") + 0.5
        z = depth.flatten()[pixels]
        local = torch.stack(
            [(x - camera.K[0, 2]) / camera.K[0, 0] * z, (y - camera.K[1, 2]) / camera.K[1, 1] * z, z], 1
        )
        return (local - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (P, 3) of all views, world units, and their colours (P, C)."""
        points = [self._at(view, self.known[view.name]).cpu().numpy() for view in self.views]
        colors = [
            view.thermal.reshape(-1, view.thermal.shape[2])[self.known[view.name].cpu().numpy()] for view in self.views
        ]
        return np.concatenate(points), np.concatenate(colors)

    def support(self, means: Tensor, tolerance: float) -> Tensor:
        """Return which means (N, 3) lie at a view's depth, to a tolerance in world units.

        As released, the first row and column of an image support nothing.
        """
        found = torch.zeros(len(means), dtype=torch.bool, device=means.device)
        for view in self.views:
            camera = self.cameras[view.name].to(means)
            found |= at_depth(means, camera, self.maps[view.name].to(means), tolerance)
        return found

    def free_points(self, view: View, share: float, reach: float, jitter: float, generator: torch.Generator) -> Tensor:
        """Draw points (n, 3) in front of and behind a view's surface; n: a share of its pixels with depth."""
        known = self.known[view.name]
        count = int(len(known) * share)
        drawn = torch.randint(max(len(known), 1), (count,), generator=generator)
        sides = 2 * torch.randint(2, (count,), generator=generator) - 1
        offsets = reach * sides + jitter * (2 * torch.rand(count, generator=generator) - 1)
        surface = self._at(view, known[drawn.to(known.device)])
        return beside(torch.from_numpy(view.camera.center).to(surface), surface, offsets.to(surface))


def at_depth(means: Tensor, camera: Pinhole, depth: Tensor, tolerance: float) -> Tensor:
    """Return which means (N, 3) lie in an image, at its depth (H, W), NaN where unknown, to a tolerance."""
    local = means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    z = local[:, 2]
    pixels = (local @ camera.K.T)[:, :2] / z[:, None]
    columns, rows = torch.nan_to_num(pixels, nan=-1.0).clamp(-1, 2**30).floor().long().unbind(1)
    inside = (z > 0) & (columns > 0) & (rows > 0) & (columns < camera.width) & (rows < camera.height)
    found = depth[torch.where(inside, rows, 0), torch.where(inside, columns, 0)]
    return inside & ((found - z).abs() <= tolerance)


def beside(center: Tensor, points: Tensor, offsets: Tensor) -> Tensor:
    """Return points (n, 3) moved by offsets (n,) along the rays from a centre (3,), but not behind it."""
    rays = points - center
    distance = rays.norm(dim=1, keepdim=True)
    return center + rays / distance * (distance + offsets[:, None]).clamp_min(0)


def free_loss(points: Tensor, means: Tensor, covariances: Tensor, opacities: Tensor, cube: float) -> Tensor:
    """Return the mean density at points (M, 3), of the Gaussians (N) whose means lie in a point's cube of a grid."""
    if not len(points):
        return means.sum() * 0
    with torch.no_grad():
        both = torch.cat([means, points])
        cells = ((both - both.amin(dim=0)) / cube).floor().long()
        _, cells = torch.unique(cells, dim=0, return_inverse=True)
        of_means, of_points = cells.split([len(means), len(points)])
    total = means.sum() * 0
    for cell in torch.unique(of_points).tolist():
        index, near = (of_means == cell).nonzero().squeeze(1), of_points == cell
        if len(index):
            total = total + density(points[near], means[index], covariances[index], opacities[index]).sum()
    return total / len(points)


def density(points: Tensor, means: Tensor, covariances: Tensor, opacities: Tensor) -> Tensor:
    """Return min(1, Σ o exp(−½ d²)) at points (M, 3), d the Mahalanobis distance from Gaussians (N)."""
    roots = torch.linalg.inv(torch.linalg.cholesky(covariances))
    whitened = torch.einsum("nij,mnj->mni", roots, points[:, None] - means)
    return (opacities * torch.exp(-0.5 * whitened.square().sum(dim=2))).sum(dim=1).clamp_max(1.0)
