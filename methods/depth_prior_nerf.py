"""A thermal radiance field with a depth prior and its standard deviation (after Roessle et al. 2022).

Roessle et al., "Dense Depth Priors for Neural Radiance Fields from Sparse Input Views", take depth and deviation from a
network that completes sparse depth of RGB images. Here, the prior is that of thermal images, aligned to sparse points
(`methods.aligned_depth`), and its deviation is the largest of three: of the view from these points, a share of the
depth, the range of neighbours. The field is ThermoNeRF's.
Constants and order: barbararoessle/dense_depth_priors_nerf, commit 7c243d24.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from pydantic import NonNegativeFloat, PositiveFloat
from scipy.ndimage import maximum_filter, minimum_filter
from torch import Tensor
from torch.nn import functional

from methods.aligned_depth import deviation, metric_depths
from methods.thermonerf import Sampled, ThermoNeRF
from tdgbench.fields.volume import transmittance_of
from tdgbench.priors import DepthPrior
from tdgbench.scenes import View
from tdgbench.training.context import Context
from tdgbench.training.part import Part, Report
from tdgbench.training.rays import RayBatch


@dataclass
class DepthPriorNeRF(ThermoNeRF):
    """L = L_ThermoNeRF + λ_depth L_depth."""

    lambda_depth: NonNegativeFloat
    added_variance: NonNegativeFloat  # of a ray's depth, squared radii of the region
    least_variance: PositiveFloat  # in the loss, likewise
    least_deviation: PositiveFloat  # of the prior, share of its depth
    occlusion: NonNegativeFloat | None  # see `metric_depths`

    def __post_init__(self) -> None:
        super().__post_init__()
        self.needs_prior = self.lambda_depth > 0
        self.deviations: dict[str, float] = {}  # by view, world units

    def setup(self, context: Context) -> None:
        super().setup(context)
        if self.deviations:
            context.add_part("depth_prior", Deviations([*self.deviations.values()]))

    def maps(self, context: Context) -> dict[str, Callable[[View], Tensor]]:
        if not self.needs_prior:
            return {}
        scene, depths, deviations = context.scene, dict[str, DepthPrior](), self.deviations
        if context.priors:  # where a stored cell is rendered again, there are none
            depths = metric_depths(scene, context.priors, self.occlusion)
            for view in scene.train:
                deviations[view.name] = deviation(scene, depths[view.name], view.camera, self.occlusion)

        def prior_of(view: View) -> Tensor:
            """Return depth and standard deviation (H, W, 2), world units, of a view; 0 where unknown."""
            values = depths[view.name].of_view(view).values
            depth = np.where(np.isfinite(values) & (values > 0), values, np.float32(0))
            spread = np.maximum(np.float32(deviations[view.name]), np.float32(self.least_deviation) * depth)
            spread = np.maximum(spread, local_range(depth))
            return torch.from_numpy(np.stack([depth, spread], axis=2))

        return {"prior": prior_of}

    def further_losses(self, batch: RayBatch, shown: Sampled) -> dict[str, Tensor]:
        if not self.needs_prior:
            return {}
        prior, unit = batch.pixels["prior"], self.field.region.radius
        mean, variance = depth_moments(shown.weights, shown.samples.depths / unit)
        depth, spread = (prior / unit).unbind(dim=1)
        loss = depth_loss(mean, variance + self.added_variance, depth, spread, self.least_variance)
        return {"depth": self.lambda_depth * loss}


class Deviations(Part):
    """Says how far the priors are from the sparse points: where a ray is nearer, the loss is 0."""

    def __init__(self, of_views: list[float]) -> None:
        """of_views: world units."""
        self.of_views = of_views

    def report(self) -> Report:
        return {"deviation_mean": float(np.mean(self.of_views)), "deviation_largest": max(self.of_views)}


def local_range(depth: np.ndarray) -> np.ndarray:
    """Return largest less smallest known depth in the 3×3 px of each pixel, as `complete_depth` (run_nerf.py).

    depth: (H, W), 0 where unknown; so is the range there.
    """
    known = depth > 0
    smallest = minimum_filter(np.where(known, depth, np.float32(np.inf)), size=3)
    return np.where(known, maximum_filter(depth, size=3) - smallest, np.float32(0))


def depth_moments(weights: Tensor, depths: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and variance (R,) of the depth at which rays end; weights and depths (R, S).

    ẑ = Σ w z and ŝ² = Σ w (z − ẑ)² (Roessle et al.). What passes all samples ends in the last one, as in the
    authors' code, whose last interval is endless.
    """
    last = weights[:, -1:] + transmittance_of(weights).clamp_min(0)[:, None]
    weights = torch.cat([weights[:, :-1], last], dim=1)
    mean = (weights * depths).sum(dim=1)
    return mean, (weights * (depths - mean[:, None]).square()).sum(dim=1)


def depth_loss(mean: Tensor, variance: Tensor, prior: Tensor, deviation: Tensor, least_variance: float) -> Tensor:
    """Return the Gaussian negative log likelihood of priors (Roessle et al.), mean over R rays; all (R,).

    ½ (log ŝ² + (ẑ − z)² / ŝ²) for rays with a prior whose |ẑ − z| or ŝ exceeds its deviation, else 0. The factor ½ is
    that of the released code, to which its weight belongs. prior: 0 where unknown. least_variance: of ŝ², without
    effect on its gradient.
    """
    outside = ((mean - prior).abs() > deviation) | (variance > deviation.square())
    counted = outside & (prior > 0)
    terms = functional.gaussian_nll_loss(mean, prior, variance, eps=least_variance, reduction="none")
    return torch.where(counted, terms, 0.0).mean()
