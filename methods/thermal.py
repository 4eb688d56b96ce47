"""MSMG's thermal model trained alone: separates what TDg gains by leaving the RGB model out from what depth brings."""

from __future__ import annotations

import torch

from tdgbench.scenes import Camera
from tdgbench.training.losses import thermal
from tdgbench.training.method import Context, Step, thermal_tensor
from tdgbench.training.model import Render, SplatModel


class Thermal:
    """L = weight · L_thermal (ThermalGaussian). In MSMG the weight is 0.6 · w_rgb, 0.3 where both models are as large;
    Adam hardly sees it, density control does."""

    name = "thermal"
    needs_rgb = False
    needs_prior = False

    def __init__(self, lambda_ssim: float, lambda_smooth: float, smooth: str, weight: float) -> None:
        self.lambda_ssim, self.lambda_smooth, self.smooth, self.weight = lambda_ssim, lambda_smooth, smooth, weight

    def setup(self, context: Context) -> None:
        self.model = context.make_model(context.scene.channels, thermal_tensor)
        self.views = context.view_order()

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.model.render(view.camera)
        target = thermal_tensor(view, render.image.device)
        loss = thermal(render.image, target, self.lambda_ssim, self.lambda_smooth, self.smooth)
        return Step(self.weight * loss, {"thermal": loss.item()}, render, target)

    def models(self) -> dict[str, SplatModel]:
        return {"thermal": self.model}

    @torch.no_grad()
    def render(self, camera: Camera) -> Render:
        return self.model.render(camera, depth=True)
