"""TDg: one Gaussian model trained on thermal images, guided by depth estimated from them.

Biswanath et al., "Supercharging Thermal Gaussian Splatting with Depth Estimation", section Method:

- eq. 2, estimated depth D: `tdgbench.priors`
- eq. 3, rendered depth: `Render.depth`
- eq. 4, depth loss: `depth_loss`
- eqs. 5 and 6, thermal loss and smoothness: `tdgbench.training.losses.thermal_loss`
- eq. 7, progressive weight: `decay_weight`
- eq. 8, total loss: `TDg.step`

The released code (HannahHaensen/TDg, commit b881cee) differs; the options `depth_reading` and `smoothness_reading`
choose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from pydantic import NonNegativeFloat
from torch import Tensor

from methods.gaussian_splatting import ThermalGaussianLosses
from tdgbench.priors import DepthPrior
from tdgbench.scenes import Camera, View
from tdgbench.splats import Gaussians
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole, Render
from tdgbench.training.context import Context
from tdgbench.training.losses import inverse_expected_depth, l1_and_dssim, min_max
from tdgbench.training.method import Step

MIN_ALPHA = 1e-3  # there is no depth to invert where alpha is not above this
RELEASED_EPSILON = 1e-6  # added to alpha: gaussian_renderer/__init__.py, line 475


@dataclass
class TDg(ThermalGaussianLosses):
    """L_total = L_thermal + w_decay(t) · λ_depth · L_depth (TDg, eq. 8)."""

    lambda_depth: NonNegativeFloat
    depth_reading: Literal["written", "released"]  # written: eq. 3, with its gradient; released: without gradient
    decay: Literal["linear", "switch"]  # linear: eq. 7
    decay_end: NonNegativeFloat  # t_end as a share of all iterations

    def __post_init__(self) -> None:
        self.needs_prior = self.lambda_depth > 0

    def setup(self, context: Context) -> None:
        self.model = context.gaussians()
        self.views = context.views()
        self.targets = DepthTargets(context.priors, context.device)
        self.backend = context.backend
        self.depth_end = int(self.decay_end * context.budget.schedule_length)  # t_end
        self.skips_depth = not self.needs_prior or self._decide_skip(context)

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        weight = self.lambda_depth * self._decay(iteration)
        needs_depth = not self.skips_depth or (weight > 0 and self.depth_reading == "written")
        render = self.model.render(view.camera, depth=needs_depth and self.depth_reading == "written")
        step = self.thermal_step(render, view)
        if not needs_depth:
            self.targets.clear()
            return step
        depth = self._depth_loss(view, render)
        return replace(step, loss=step.loss + weight * depth, terms={**step.terms, "depth": depth})

    def _decay(self, iteration: int) -> float:
        if self.decay == "switch":  # the hard supervision switch that eq. 7 avoids
            return float(iteration < self.depth_end)
        return decay_weight(iteration, 1, self.depth_end)

    def _depth_loss(self, view: View, render: Render) -> Tensor:
        prior = self.targets.for_view(view)
        if self.depth_reading == "released":
            rendered = released_depth(self.model.copy(), view.camera, self.backend)
            # TDg.py, lines 202 to 219: L1 + (1 − SSIM), with 0 where the prior is unknown
            return l1_and_dssim(rendered[..., None], prior.image, 1.0, 1.0)
        return depth_loss(comparable_depth(render, prior.kind), prior)

    def _decide_skip(self, context: Context) -> bool:
        """Decide whether iterations in which the depth loss moves nothing leave it out."""
        iterations = context.budget.iterations
        without, reason = min(iterations, max(0, iterations - self.depth_end + 1)), ""
        if self.depth_reading == "released":
            without = iterations
            reason = "as released, the depth loss has no gradient: it is added to the loss and moves nothing"
        return context.skips.skip_depth(without, iterations, reason)


@dataclass(frozen=True)
class DepthTarget:
    """A depth prior, normalised for the loss."""

    normalised: Tensor  # (H, W) in [0, 1]; 0 where unknown
    valid: Tensor | None  # (H, W) bool: where the prior is known; None: everywhere
    kind: str
    known: int = 0  # the first of the pixels that are known, counted along rows; -1: none is

    @cached_property
    def image(self) -> Tensor:
        """The normalised prior (H, W, 1); losses prepare a tensor once, by its identity."""
        return self.normalised[..., None]

    @classmethod
    def from_prior(cls, prior: DepthPrior, device: torch.device) -> DepthTarget:
        """Normalise a prior."""
        values = torch.from_numpy(prior.values).to(device)
        valid = torch.isfinite(values)
        if bool(valid.all()):
            return cls(min_max(values), None, prior.kind)
        known = int(np.isfinite(prior.values).argmax()) if bool(valid.any()) else -1
        normalised = torch.where(valid, min_max(_fill_unknown(values, valid, known)), 0.0)
        return cls(normalised, valid, prior.kind, known)


class DepthTargets:
    """Depth priors by view, normalised at the resolution at which the view is trained on."""

    def __init__(self, priors: dict[str, DepthPrior], device: torch.device) -> None:
        self._priors, self._device = priors, device
        self.made: dict[str, DepthTarget] = {}  # at the resolution of the last use

    def __len__(self) -> int:
        return len(self._priors)

    def clear(self) -> None:
        """Free the memory of the normalised maps, and of what the losses keep of them."""
        self.made.clear()

    def for_view(self, view: View) -> DepthTarget:
        """Return the target of a view, in the size of its image."""
        size = (view.camera.height, view.camera.width)
        if view.name not in self.made or self.made[view.name].normalised.shape != size:
            self.made[view.name] = DepthTarget.from_prior(self._priors[view.name].of_view(view), self._device)
        return self.made[view.name]


def comparable_depth(render: Render, kind: str) -> Tensor:
    """Return the rendered depth (H, W): accumulated z (TDg, eq. 3), or the inverse z if the prior is a disparity."""
    depth = render.requested_depth
    if kind != "disparity":
        return depth
    return inverse_expected_depth(depth, render.transmittance, MIN_ALPHA)


def depth_loss(rendered: Tensor, target: DepthTarget) -> Tensor:
    """Return the depth loss (TDg, eq. 4): L1 + (1 − SSIM) of min-max normalised maps (H, W) where the prior is known.

    >>> depth = torch.rand(16, 16)
    >>> target = DepthTarget.from_prior(DepthPrior((3 * depth + 2).numpy(), "depth"), torch.device("cpu"))
    >>> abs(depth_loss(depth, target).item()) < 1e-5
    True
    """
    if target.known < 0:
        return 0.0 * rendered.sum()
    if target.valid is None:
        normalised = min_max(rendered)
    else:
        normalised = torch.where(target.valid, min_max(_fill_unknown(rendered, target.valid, target.known)), 0.0)
    return l1_and_dssim(normalised[..., None], target.image, 1.0, 1.0, target.valid)


def _fill_unknown(values: Tensor, valid: Tensor, known: int) -> Tensor:
    """Return the map (H, W) with the value of a known pixel in all unknown ones, so that these are no extremes."""
    return torch.where(valid, values, values.flatten()[known].detach())


def decay_weight(iteration: int, start: int, end: int) -> float:
    """Return the progressive weight w_decay(t) (TDg, eq. 7): falls linearly from 1 at `start` to 0 at `end`.

    >>> [decay_weight(t, 1, 501) for t in (1, 251, 501, 900)]
    [1.0, 0.5, 0.0, 0.0]
    """
    return 1.0 - (iteration - start) / (end - start) if iteration < end else 0.0


@torch.no_grad()
def released_depth(gaussians: Gaussians, camera: Camera, backend: str) -> Tensor:
    """Return the rendered depth (H, W) in [0, 1] as released (gaussian_renderer/__init__.py, from line 404).

    Each Gaussian's z is min-max normalised over all Gaussians with z > 0 (others get 0), blended, and divided by alpha.
    z comes from the transposed view matrix: the rotation is inverted, and the translation is dropped.
    """
    pinhole = Pinhole.of(camera).to(gaussians.means)
    z = gaussians.means @ pinhole.viewmat[:3, 2] + pinhole.viewmat[3, 2]
    valid = torch.isfinite(z) & (z > 0)
    known = z[valid]
    if not len(known):
        normalised = torch.zeros_like(z)
    elif known.max() - known.min() > 1e-9:
        normalised = torch.where(valid, (z - known.min()) / (known.max() - known.min()), 0.0).clamp(0, 1)
    else:
        normalised = torch.where(valid, 0.5, 0.0)
    coloured = GaussianTensors(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, normalised[:, None]
    )
    rendered = render_view(coloured, pinhole, backend=backend)
    return rendered.image[..., 0] / (1 - rendered.transmittance + RELEASED_EPSILON)
