"""TDg: one Gaussian model trained on thermal images, guided by a depth prior estimated from them.

Biswanath et al., "Supercharging Thermal Gaussian Splatting with Depth Estimation", section Method.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from tdgbench.priors import DepthPrior
from tdgbench.scenes import Camera
from tdgbench.training.losses import inverse_expected_depth, l1, l1_and_dssim, min_max, ssim, thermal
from tdgbench.training.method import Context, Step, thermal_tensor
from tdgbench.training.model import Render, SplatModel

MIN_ALPHA = 1e-3  # where less light than this is stopped, there is no depth to invert


def comparable_depth(render: Render, kind: str) -> Tensor:
    """The rendered map in the prior's own kind of number: accumulated z (eq. 3), or inverse z for a disparity."""
    assert render.depth is not None
    if kind != "disparity":
        return render.depth
    return inverse_expected_depth(render.depth, render.transmittance, MIN_ALPHA)


@dataclass(frozen=True)
class DepthTarget:
    """A prior made ready for the loss: normalised, and where it is known (None: everywhere)."""

    normalised: Tensor  # (H, W) in [0, 1]; 0 where unknown
    valid: Tensor | None  # (H, W) bool
    kind: str

    @classmethod
    def of(cls, prior: DepthPrior, device: torch.device) -> DepthTarget:
        values = torch.from_numpy(prior.values).to(device)
        valid = torch.isfinite(values)
        if bool(valid.all()):
            return cls(min_max(values), None, prior.kind)
        normalised = torch.where(valid, min_max(_known(values, valid)), 0.0)
        return cls(normalised, valid, prior.kind)


def depth_loss(rendered: Tensor, target: DepthTarget) -> Tensor:
    """Depth loss (TDg, eq. 4): L1 + (1 − SSIM) of the min-max normalised maps (H, W), where the prior is known."""
    if target.valid is None:
        return l1_and_dssim(min_max(rendered)[..., None], target.normalised[..., None], 1.0, 1.0)
    a = torch.where(target.valid, min_max(_known(rendered, target.valid)), 0.0)[..., None]
    b = target.normalised[..., None]
    share = target.valid.sum() / target.valid.numel()
    return l1(a, b) / share + (1 - ssim(a, b))


def _known(values: Tensor, valid: Tensor) -> Tensor:
    """The map with unknown pixels set to a known one, so that they are no extremes."""
    return torch.where(valid, values, values[valid][0].detach())


def decay_weight(iteration: int, start: int, end: int) -> float:
    """Progressive weight (TDg, eq. 7): falls linearly from 1 at `start` to 0 at `end`."""
    return max(0.0, 1.0 - (iteration - start) / max(end - start, 1))


class TDg:
    """L_total = L_thermal + w_decay(t) · λ_depth · L_depth (TDg, eq. 8)."""

    name = "tdg"
    needs_rgb = False
    needs_prior = True

    def __init__(
        self, lambda_ssim: float, lambda_smooth: float, smooth: str, lambda_depth: float, decay_end: float
    ) -> None:
        """decay_end: where the depth loss has faded out, as a share of all iterations."""
        self.lambda_ssim, self.lambda_smooth, self.smooth = lambda_ssim, lambda_smooth, smooth
        self.lambda_depth, self.decay_end = lambda_depth, decay_end

    def setup(self, context: Context) -> None:
        self.model = context.make_model(context.scene.channels, thermal_tensor)
        self.views = context.view_order()
        self.targets = {name: DepthTarget.of(prior, context.device) for name, prior in context.priors.items()}
        self.last_depth_iteration = round(self.decay_end * context.budget.iterations)
        without = max(0, context.budget.iterations - self.last_depth_iteration + 1)
        if self.lambda_depth == 0:
            without = context.budget.iterations
        self.skips_depth = context.skips.depth.decide(
            without > 0,
            f"the depth loss weighs nothing from iteration {context.budget.iterations - without + 1} on",
            f"depth and its loss in {without} of {context.budget.iterations} iterations",
        )

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        weight = self.lambda_depth * decay_weight(iteration, 1, self.last_depth_iteration)
        needs_depth = weight > 0 or not self.skips_depth
        render = self.model.render(view.camera, depth=needs_depth)
        target = thermal_tensor(view, render.image.device)
        loss = thermal(render.image, target, self.lambda_ssim, self.lambda_smooth, self.smooth)
        terms = {"thermal": loss.item()}
        if needs_depth:
            prior = self.targets[view.name]
            depth = depth_loss(comparable_depth(render, prior.kind), prior)
            terms["depth"] = depth.item()
            loss = loss + weight * depth
        return Step(loss, terms, render, target)

    def models(self) -> dict[str, SplatModel]:
        return {"thermal": self.model}

    @torch.no_grad()
    def render(self, camera: Camera) -> Render:
        return self.model.render(camera, depth=True)
