"""SAD-GS: 3DGS from metric depth, with Gaussians of its voxels and a loss in front of and behind its surfaces.

Constants and order are those of umautobots/SAD-GS, commit f9055f74, with the options of its full method
(demo_run_batch_replica.py). That is for RGB-D images of rooms, with depth in metres. Here, images are thermal; a metric
prior is taken as it is, another one is aligned to sparse points (`methods.aligned_depth`). Numbers of iterations are
shares of the authors' 2 000. Two resets differ: 3DGS's opacity reset comes not so late that the saved model has not
recovered (the authors make one at the last iteration, after saving); opacities do not fade soon after it, while they
are low for all Gaussians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat
from torch import Tensor

from methods.aligned_depth import metric_depths
from methods.voxels import voxel_gaussians
from tdgbench.priors import DepthPrior, PriorError
from tdgbench.scenes import Scene, View
from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityChange, DensityControl, DensityRules, GrowthDecision
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import GaussianTensors, Pinhole
from tdgbench.training.budget import Budget
from tdgbench.training.context import Context
from tdgbench.training.images import THERMAL
from tdgbench.training.losses import photometric
from tdgbench.training.method import Method, Share, Step
from tdgbench.training.part import Part

FARTHEST = 6.0  # deviations from a Gaussian, beyond which its density, at most exp(−18), is left out


def iterations_of(share: float, budget: Budget) -> int:
    """Return a share of all iterations, at least one."""
    return max(1, round(share * budget.schedule_length))


@dataclass
class SADGS(Method):
    """L = λ_image ((1 − λ_ssim) L1 + λ_ssim (1 − SSIM)) + L_free. Lengths are in metres."""

    needs_prior = True
    keeps_all_points = True
    can_learn_rig = False  # its surfaces are those of the given cameras

    lambda_ssim: Share
    lambda_image: NonNegativeFloat
    metre: PositiveFloat | None  # × the cameras' extent; None: the scene's unit is the metre
    voxel: PositiveFloat  # side
    reach: PositiveFloat  # of free points from the surface
    jitter: NonNegativeFloat  # of reach, at most
    drawn: Share  # free points, share of a view's pixels with depth
    cube: PositiveFloat  # side; Gaussians act on points in the same one
    blur: PositiveFloat  # added to variances, square metres
    tolerance: NonNegativeFloat  # of support
    fade: Annotated[float, Field(gt=0, le=1)]  # factor of opacities without support
    fade_every: Share  # of all iterations
    fade_pause: Share  # of all iterations, after an opacity reset
    densify_from: Share | None  # of all iterations; None: as the budget
    reset_every: Share | None  # of all iterations; None: as the budget
    to_the_end: bool  # whether density control goes on to the last iteration; else it stops as the budget says
    means_steps: PositiveFloat | None  # × all iterations, over which the means' rate falls; None: as the budget
    sh_every: Share | None  # of all iterations; None: as the budget
    occlusion: NonNegativeFloat | None  # see `metric_depths`

    def setup(self, context: Context) -> None:
        scene, budget = context.scene, context.budget
        self.unit = 1.0 if self.metre is None else self.metre * scene.extent
        if not context.priors:  # where a training is looked at from outside
            self.model = context.gaussians()
            return
        depths = metric_depths(scene, context.priors, self.occlusion)
        self.surfaces = context.add_part("surfaces", Surfaces(scene, depths, context.device, self.unit))
        start = voxel_gaussians(*self.surfaces.points(), self.voxel * self.unit, budget.sh_degree)
        budget = replace(budget, density=self._density(budget), **self._schedules(budget))
        self.model, self.views = context.gaussians(start=start, budget=budget), context.views()
        self.draws, self.last = context.random("free_points"), budget.iterations

    def _schedules(self, budget: Budget) -> dict[str, Any]:
        """Return the fields of the budget that its learning rate and harmonics change."""
        given: dict[str, Any] = {}
        if self.means_steps is not None:
            given["rates"] = replace(budget.rates, means_steps=iterations_of(self.means_steps, budget))
        if self.sh_every is not None:
            given["sh_every"] = iterations_of(self.sh_every, budget)
        return given

    def _density(self, budget: Budget) -> DensityRules:
        """Return the density control of 3DGS with fading; another one stays as it is, without."""
        rules = budget.density
        if type(rules) is not DensityRules:
            return rules

        given = {**vars(rules), "supported": partial(self.surfaces.support, tolerance=self.tolerance * self.unit)}
        if self.densify_from is not None:
            given["start"] = round(self.densify_from * budget.schedule_length)
        if self.reset_every is not None:
            given["opacity_reset_every"] = iterations_of(self.reset_every, budget)
        if self.to_the_end:
            given["stop"] = budget.iterations + 1
        pause = round(self.fade_pause * budget.schedule_length)
        return SupportRules(
            **given, fade=self.fade, fade_every=iterations_of(self.fade_every, budget), fade_pause=pause
        )

    def step(self, iteration: int) -> Step:
        view, free, unit = self.views.next(), list[Tensor](), self.unit
        points = self.surfaces.free_points(view, self.drawn, self.reach * unit, self.jitter * unit, self.draws)

        def hook(gaussians: Gaussians, degree: int) -> GaussianTensors:
            free.append(free_loss(points, gaussians, self.blur * unit**2, self.cube * unit))
            return gaussians.activated(degree)

        render = self.model.render(view.camera, hook=hook)
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = photometric(render.image, target, self.lambda_ssim, valid)
        control = self.model.density
        if iteration == self.last and isinstance(control, SupportControl) and control.fades(iteration):
            control.fade_unsupported(self.model.optimizer)  # as released, before saving; no update follows
        terms = {"thermal": loss, "free": free[0]}
        return Step(self.lambda_image * loss + free[0], terms, render, target, valid)


@dataclass(frozen=True, kw_only=True)
class SupportRules(DensityRules):
    """Rules of 3DGS, and opacities that fade where no training view has a surface."""

    fade: float
    fade_every: int  # iterations
    fade_pause: int  # iterations
    supported: Callable[[Tensor], Tensor]  # of means (N, 3): which are near a surface (N,)

    def control(self, extent: float, state: TrainingState, iterations: int) -> DensityControl:
        return SupportControl(self, extent, state, iterations)


class SupportControl(DensityControl):
    """Lets Gaussians without support fade, before it clones, splits and prunes (train.py, lines 298 to 315)."""

    rules: SupportRules

    def fades(self, iteration: int) -> bool:
        """Return whether opacities fade at an iteration."""
        if not self.is_active(iteration) or iteration % self.rules.fade_every:
            return False
        return not any(self._is_reset(before) for before in range(iteration - self.rules.fade_pause, iteration))

    def is_due(self, iteration: int) -> bool:
        return self.fades(iteration) or super().is_due(iteration)

    @torch.no_grad()
    def update(
        self, optimizer: Adam, iteration: int, generator: torch.Generator, decision: GrowthDecision | None = None
    ) -> DensityChange:
        fades = self.fades(iteration)
        if fades:
            self.fade_unsupported(optimizer)
        change = super().update(optimizer, iteration, generator, decision)
        change.opacity_reset |= fades  # no step of opacities follows
        return change

    @torch.no_grad()
    def fade_unsupported(self, optimizer: Adam) -> None:
        """Multiply opacities without support, and forget the moments of all."""
        optimizer.flush()
        many = self.state.split(self.state.values)
        logits = many.opacity_logits
        faded = (self.rules.fade * many.opacities).clamp_min(torch.finfo(logits.dtype).tiny).logit()  # finite
        logits.copy_(torch.where(self.rules.supported(many.means), logits, faded))
        optimizer.reset_moments("opacity_logits")


class Surfaces(Part):
    """Depth maps of the training views, on the device of the training."""

    def __init__(self, scene: Scene, depths: dict[str, DepthPrior], device: torch.device, metre: float) -> None:
        """depths: z by view, NaN or not positive where unknown; in world units, as the metre. Raises PriorError."""
        self.views, self.metre = scene.train, metre
        self.cameras, self.maps, self.known = {}, {}, {}
        for view in scene.train:
            depth = torch.from_numpy(depths[view.name].values).to(device)
            self.maps[view.name] = torch.where(depth > 0, depth, torch.nan)
            self.known[view.name] = torch.isfinite(self.maps[view.name]).flatten().nonzero().squeeze(1)
            self.cameras[view.name] = Pinhole.of(view.camera).to(depth)
        if not any(map(len, self.known.values())):
            raise PriorError(f"no depth prior of {scene.name} has a positive depth, from which Gaussians could start")

    def report(self) -> dict[str, Any]:
        """Return the pixels with depth, and a metre in world units."""
        return {"pixels": sum(map(len, self.known.values())), "metre": self.metre}

    def _at(self, view: View, pixels: Tensor) -> Tensor:
        """Return the points (n, 3), world units, of pixels (n,), counted row by row, of a view."""
        camera, z = self.cameras[view.name], self.maps[view.name].flatten()[pixels]
        x, y = pixels % camera.width + 0.5, pixels // camera.width + 0.5
        local = torch.stack([x, y, torch.ones_like(x)], dim=1) @ torch.linalg.inv(camera.K).T * z[:, None]
        return (local - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (P, 3) of all views, world units, and their colours (P, C)."""
        points = [self._at(view, self.known[view.name]).cpu().numpy() for view in self.views]
        colors = [view.thermal.reshape(-1, view.thermal.shape[2])[self.known[view.name].cpu()] for view in self.views]
        return np.concatenate(points), np.concatenate(colors)

    def support(self, means: Tensor, tolerance: float) -> Tensor:
        """Return which means (N, 3) lie at the depth of a view, to a tolerance in world units."""
        found = torch.zeros(len(means), dtype=torch.bool, device=means.device)
        for name, camera in self.cameras.items():
            found |= at_depth(means, camera, self.maps[name], tolerance)
        return found

    def free_points(self, view: View, share: float, reach: float, jitter: float, generator: torch.Generator) -> Tensor:
        """Draw points (n, 3) in front of and behind a view's surface; n: a share of its pixels with depth."""
        known = self.known[view.name]
        count = int(len(known) * share)
        drawn = torch.randint(max(len(known), 1), (count,), generator=generator)
        offsets = reach * (2 * torch.randint(2, (count,), generator=generator) - 1)
        offsets = offsets + jitter * (2 * torch.rand(count, generator=generator) - 1)
        surface = self._at(view, known[drawn.to(known.device)])
        return beside(torch.from_numpy(view.camera.center).to(surface), surface, offsets.to(surface))


def at_depth(means: Tensor, camera: Pinhole, depth: Tensor, tolerance: float) -> Tensor:
    """Return which means (N, 3) lie in an image, at its depth (H, W), NaN where unknown, to a tolerance.

    As released, the first row and column of an image support nothing.
    """
    local = means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    z = local[:, 2]
    pixels = (local @ camera.K.T)[:, :2] / z[:, None]
    columns, rows = pixels.nan_to_num(-1.0).clamp(-1, 2**30).floor().long().unbind(1)
    inside = (z > 0) & (columns > 0) & (rows > 0) & (columns < camera.width) & (rows < camera.height)
    found = depth[torch.where(inside, rows, 0), torch.where(inside, columns, 0)]
    return inside & ((found - z).abs() <= tolerance)


def beside(center: Tensor, points: Tensor, offsets: Tensor) -> Tensor:
    """Return points (n, 3) moved by offsets (n,) along the rays from a centre (3,), but not behind it."""
    rays = points - center
    distance = rays.norm(dim=1, keepdim=True)
    return center + rays / distance * (distance + offsets[:, None]).clamp_min(0)


def free_loss(points: Tensor, gaussians: Gaussians, blur: float, cube: float) -> Tensor:
    """Return L_free, the mean of min(1, Σ o exp(−½ d²)) over free points (M, 3) (train.py, lines 239 to 267).

    d is the Mahalanobis distance from a Gaussian; Σ is over those whose mean is in the point's cube of a grid, without
    pairs beyond FARTHEST. blur: added to variances, squared world units. cube: its side, world units.
    """
    means, log_scales = gaussians.means, gaussians.log_scales
    largest = ((2 * log_scales.detach().amax(dim=1)).exp() + blur).sqrt()
    at, of = pairs_in_cubes(points, means.detach(), FARTHEST * largest, cube)
    along = (rotation_matrices(gaussians.quats[of]).mT @ (points[at] - means[of])[..., None]).squeeze(2)
    whitened = along / ((2 * log_scales[of]).exp() + blur).sqrt()
    found = density(whitened, gaussians.opacity_logits[of].sigmoid(), at, len(points))
    return found.sum() / max(len(points), 1)


@torch.no_grad()
def pairs_in_cubes(points: Tensor, means: Tensor, reach: Tensor, cube: float) -> Tensor:
    """Return pairs (2, P) of point and Gaussian that are in the same cube of a grid, and nearer than `reach`.

    points (M, 3), means (N, 3), reach (N,), cube (its side): world units.
    """
    if not len(points):
        return points.new_zeros(2, 0, dtype=torch.int64)
    low, steps = torch.minimum(means.amin(dim=0), points.amin(dim=0)), torch.tensor([1, 2**20, 2**40]).to(points.device)
    of_means, of_points = ((((some - low) / cube).long() * steps).sum(dim=1) for some in (means, points))
    cells, of_points = of_points.unique(return_inverse=True)
    place = torch.searchsorted(cells, of_means).clamp_max(len(cells) - 1)
    near, found = (cells[place] == of_means).nonzero().squeeze(1), []
    for cell in range(len(cells)):
        at, of = (of_points == cell).nonzero().squeeze(1), near[place[near] == cell]
        distances = torch.cdist(points[at], means[of], compute_mode="donot_use_mm_for_euclid_dist")
        hits = (distances < reach[of]).nonzero()
        found.append(torch.stack([at[hits[:, 0]], of[hits[:, 1]]]))
    return torch.cat(found, dim=1)


def density(whitened: Tensor, opacities: Tensor, at: Tensor, count: int) -> Tensor:
    """Return min(1, Σ o exp(−½ |w|²)) at points (count,), of pairs with Gaussians.

    whitened: w (P, 3), the pair's offset along the Gaussian's axes / deviations; opacities: o (P,); at: point (P,).
    """
    values = opacities * torch.exp(-0.5 * whitened.square().sum(dim=1))
    return values.new_zeros(count).index_add(0, at, values).clamp_max(1.0)
