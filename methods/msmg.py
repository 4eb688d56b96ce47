"""MSMG, multiple single-modal Gaussians: an RGB and a thermal model trained together (ThermalGaussian, Lu et al. 2024).

The models share their initial points and the loss. In it, each term is weighted by the share of the *other* model in
all Gaussians. This scales the gradients that density control tests, and so limits the growth of the larger model.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from pydantic import NonNegativeFloat

from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.images import RGB, THERMAL
from tdgbench.training.losses import photometric, thermal_loss
from tdgbench.training.method import Frame, Method, Share, SmoothnessReading, Step


@dataclass
class MSMG(Method):
    """L = weight_rgb · w_thermal · L_rgb + weight_thermal · w_rgb · L_thermal, with w the shares in all Gaussians.

    L_rgb is 3DGS's loss (eq. 7), L_thermal that of ThermalGaussian, with smoothness.
    """

    modalities = ("thermal", "rgb")

    lambda_ssim: Share
    lambda_smooth: NonNegativeFloat
    smoothness_reading: SmoothnessReading
    weight_rgb: NonNegativeFloat
    weight_thermal: NonNegativeFloat

    def setup(self, context: Context) -> None:
        self.rgb = context.gaussians("rgb")
        self.thermal = context.gaussians("thermal")
        self.rgb_views = context.views("rgb_views")
        self.thermal_views = context.views("thermal_views")

    def step(self, iteration: int) -> Step:
        rgb_view, thermal_view = self.rgb_views.next(), self.thermal_views.next()
        image = self.rgb.render(rgb_view.camera).image
        loss_rgb = photometric(image, RGB.tensors_of(rgb_view, image.device)[0], self.lambda_ssim)
        render = self.thermal.render(thermal_view.camera)
        target, valid = THERMAL.tensors_of(thermal_view, render.image.device)
        loss_thermal = thermal_loss(
            render.image, target, self.lambda_ssim, self.lambda_smooth, self.smoothness_reading, valid
        )
        share_rgb = len(self.rgb) / (len(self.rgb) + len(self.thermal))
        loss = self.weight_rgb * (1 - share_rgb) * loss_rgb + self.weight_thermal * share_rgb * loss_thermal
        return Step(loss, {"rgb": loss_rgb, "thermal": loss_thermal}, render, target, valid)

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        model = {"thermal": self.thermal, "rgb": self.rgb}[modality]
        return model.render(frame.camera, depth=modality == "thermal")
