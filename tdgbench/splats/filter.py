"""The two filters of Mip-Splatting (Yu et al. 2024), against Gaussians thinner than what images resolve.

The 3-D filter widens a Gaussian by the sampling distance of the training view that samples it best, and makes it
fainter so that its integral stays. The 2-D filter widens it on the image by a fixed kernel, and makes it fainter
likewise, in the place of 3DGS's 0.3 px² without compensation. Constants and order follow the authors' code
(autonomousvision/mip-splatting, commit dda02ab5: scene/gaussian_model.py, train.py, cuda_rasterizer/forward.cu).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from pydantic import PositiveFloat, PositiveInt
from torch import Tensor

from tdgbench.splats.backends.backend import Hook
from tdgbench.splats.backends.reference import project
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import NEAR_PLANE, CameraLike, GaussianTensors, Pinhole

FIELD = "filter_3D"  # of the Gaussians: (N, 1) standard deviations, world units
MARGIN = 0.15  # of the image: a view sees Gaussians so far beyond its border
EPS = 1e-6  # px⁴ of determinants, and the least square of the compensation


@dataclass(frozen=True)
class FilterRule:
    """Sizes of the filters, and when those in 3-D are computed anew beside the rounds of density control."""

    variance: PositiveFloat  # of the 3-D filter, px² of the best view
    kernel: PositiveFloat  # px², the variance of the 2-D filter
    every: PositiveInt  # iterations, after density control; none in the last so many


class Filter:
    """The filters of a model's Gaussians, whose field `FIELD` holds the sizes of those in 3-D."""

    def __init__(
        self, rule: FilterRule, cameras: Sequence[CameraLike], camera_of: Callable[..., CameraLike] = lambda c: c
    ) -> None:
        """cameras: of the training views. camera_of: maps a view's camera to the one that took it."""
        self.rule, self.cameras, self.camera_of = rule, cameras, camera_of

    def is_due(self, iteration: int, stop: int, iterations: int) -> bool:
        """Return whether sizes are computed anew at an iteration of so many, where density control stops at `stop`."""
        return iteration % self.rule.every == 0 and stop < iteration < iterations - self.rule.every

    @torch.no_grad()
    def sizes(self, means: Tensor) -> Tensor:
        """Return the sizes (N,) of the 3-D filter, world units, at means (N, 3).

        A Gaussian that no view sees has the largest size of the others; 0 if there is no other.
        """
        nearest, longest = torch.full_like(means[:, 0], torch.inf), 0.0
        for camera in map(self.camera_of, self.cameras):
            viewmat, K, width, height = Pinhole.of(camera).to(means)[:4]
            x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).unbind(-1)
            column, row = x / z * K[0, 0] + K[0, 2], y / z * K[1, 1] + K[1, 2]
            seen = (z > NEAR_PLANE) & (column >= -MARGIN * width) & (column <= (1 + MARGIN) * width)
            seen &= (row >= -MARGIN * height) & (row <= (1 + MARGIN) * height)
            nearest = torch.where(seen, torch.minimum(nearest, z), nearest)
            longest = max(longest, float(K[0, 0]))
        known = nearest.isfinite()
        farthest = nearest[known].amax() if bool(known.any()) else 0.0
        return torch.where(known, nearest, farthest) / longest * self.rule.variance**0.5

    @torch.no_grad()
    def update(self, state: TrainingState) -> None:
        """Compute the sizes of all Gaussians anew. All rows must be current."""
        state.values[:, state.columns_of(FIELD)] = self.sizes(state.split(state.values).means)[:, None]

    @torch.no_grad()
    def cap(self, state: TrainingState, ceiling: float) -> None:
        """Lower opacities so that none is above a ceiling after the 3-D filter. All rows must be current."""
        some = state.split(state.values)
        _, factor = filtered(some.scales, some.extra_fields[FIELD])
        limit = (ceiling / factor).clamp_max(1 - torch.finfo(torch.float32).eps)
        some.opacity_logits.copy_(torch.minimum(some.opacity_logits, limit.logit()))

    def widened(self, hook: Hook | None) -> Hook:
        """Return the hook with the 3-D filter after it."""

        def wide(gaussians: Gaussians, degree: int) -> GaussianTensors:
            active = (hook or Gaussians.activated)(gaussians, degree)
            sizes = gaussians.extra_fields[FIELD].detach()
            if len(active.means) != len(sizes):
                raise ValueError(
                    f"the method renders {len(active.means)} of {len(sizes)} Gaussians, and these have filters each; "
                    "run it with budget.filter=null"
                )
            scales, factor = filtered(active.scales, sizes)
            return active._replace(scales=scales, opacities=active.opacities * factor)

        return wide

    def compensated(self, hook: Hook, camera: Pinhole) -> tuple[Hook, Pinhole]:
        """Return the hook and the camera with the 2-D filter."""

        def seen(gaussians: Gaussians, degree: int) -> GaussianTensors:
            active = hook(gaussians, degree)
            return active._replace(opacities=active.opacities * compensation(active, camera, self.rule.kernel))

        return seen, camera._replace(eps2d=self.rule.kernel)


def filtered(scales: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    """Return the scales (N, 3) after a 3-D filter of sizes (N, 1), and the factor (N,) of opacities.

    >>> scales, factor = filtered(torch.tensor([[3.0, 3.0, 3.0]]), torch.tensor([[4.0]]))
    >>> scales.tolist(), round(factor.item(), 3)
    ([[5.0, 5.0, 5.0]], 0.216)
    """
    wide = (scales.square() + sizes.square()).sqrt()
    return wide, (scales / wide).prod(dim=1)


def compensation(gaussians: GaussianTensors, camera: Pinhole, kernel: float) -> Tensor:
    """Return the factor (N,) of opacities for a 2-D filter of a variance, px²; 1 for Gaussians behind the camera."""
    means, quats, scales = gaussians[:3]
    camera = camera.to(means)
    depths = means.detach() @ camera.viewmat[2, :3].detach() + camera.viewmat[2, 3].detach()
    front = (depths > camera.near_plane).nonzero().squeeze(1)
    _, _, covariance, _ = project(means[front], quats[front], scales[front], *camera[:4], 0.0)
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    before, after = a * c - b * b, (a + kernel) * (c + kernel) - b * b
    factor = (before.clamp_min(EPS) / (after.clamp_min(EPS) + EPS) + EPS).sqrt()
    factor = torch.where(before > EPS, factor, 0.0)
    return torch.ones_like(depths).index_put((front,), factor)
