"""MSMG, multiple single-modal Gaussians: an RGB and a thermal model trained together (ThermalGaussian, Lu et al. 2024).

The models share their initial points and the loss. In it, each term is weighted by the share of the *other* model in
all Gaussians. This scales the gradients that density control tests, and so limits the growth of the larger model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from pydantic import NonNegativeFloat

from methods.gaussian_splatting import ThermalGaussianLosses
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.method import Frame, Step


@dataclass
class MSMG(ThermalGaussianLosses):
    """L = weight_rgb · w_thermal · L_rgb + weight_thermal · w_rgb · L_thermal, with w the shares in all Gaussians."""

    modalities = ("thermal", "rgb")

    weight_rgb: NonNegativeFloat
    weight_thermal: NonNegativeFloat

    def setup(self, context: Context) -> None:
        self.rgb = context.gaussians("rgb")
        self.thermal = context.gaussians("thermal")
        self.rgb_views = context.views("rgb_views", "rgb")
        self.thermal_views = context.views("thermal_views")

    def step(self, iteration: int) -> Step:
        """Both models take part until the images of one have ended its training (`SettlingRule`)."""
        share_rgb = len(self.rgb) / (len(self.rgb) + len(self.thermal))
        losses, terms = [], {}
        if not (self.rgb_views.has_ended and self.rgb.has_recovered(iteration)):
            view = self.rgb_views.next()
            shown = self.rgb_step(self.rgb.render(view.camera), view)
            terms["rgb"] = shown.loss
            losses.append(self.weight_rgb * (1 - share_rgb) * shown.loss)
        if not (self.thermal_views.has_ended and self.thermal.has_recovered(iteration)) or not losses:
            view = self.thermal_views.next()
            shown = self.thermal_step(self.thermal.render(view.camera), view)
            terms["thermal"] = shown.loss
            losses.append(self.weight_thermal * share_rgb * shown.loss)
        return replace(shown, loss=sum(losses[1:], start=losses[0]), terms=terms)

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        model = {"thermal": self.thermal, "rgb": self.rgb}[modality]
        return model.render(frame.camera, depth=modality == "thermal")
