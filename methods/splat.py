"""One Gaussian model on thermal images alone: plain 3DGS (Kerbl et al. 2023), or the thermal model of MSMG.

3DGS compared with TDg shows the gain of depth and smoothness; MSMG's model compared with MSMG that of leaving out RGB.
"""

from __future__ import annotations

import torch
from pydantic import NonNegativeFloat

from tdgbench.scenes import Camera
from tdgbench.splats.view import Render
from tdgbench.training.losses import thermal
from tdgbench.training.method import Context, Share, SmoothnessReading, Step, thermal_tensor, valid_tensor
from tdgbench.training.model import SplatModel


class Splat:
    """L = weight · ((1 − λ_ssim) L1 + λ_ssim (1 − SSIM) + λ_smooth L_smooth): 3DGS, eq. 7; ThermalGaussian.

    The weight hardly affects Adam, but density control. In MSMG it is 0.6 × the RGB model's share in all Gaussians.
    """

    name = "splat"
    needs_rgb = False
    needs_prior = False

    def __init__(
        self, lambda_ssim: Share, lambda_smooth: NonNegativeFloat, smooth: SmoothnessReading, weight: NonNegativeFloat
    ) -> None:
        self.lambda_ssim, self.lambda_smooth, self.smooth, self.weight = lambda_ssim, lambda_smooth, smooth, weight

    def setup(self, context: Context) -> None:
        self.model = context.make_model(context.scene.channels)
        self.views = context.view_order()

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.model.show(view)
        device = render.image.device
        target, valid = thermal_tensor(view, device), valid_tensor(view, device)
        loss = thermal(render.image, target, self.lambda_ssim, self.lambda_smooth, self.smooth, valid)
        return Step(self.weight * loss, {"thermal": loss.item()}, render, target, valid)

    def models(self) -> dict[str, SplatModel]:
        return {"thermal": self.model}

    @torch.no_grad()
    def render(self, camera: Camera) -> Render:
        return self.model.render(camera, depth=True)
