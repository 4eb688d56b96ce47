"""One Gaussian model on thermal images alone: plain 3DGS (Kerbl et al. 2023), or the thermal model of MSMG.

3DGS compared with TDg shows the gain of depth and smoothness; MSMG's model compared with MSMG that of leaving out RGB.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import NonNegativeFloat

from tdgbench.training.context import Context
from tdgbench.training.images import THERMAL
from tdgbench.training.losses import thermal_loss
from tdgbench.training.method import Method, Share, SmoothnessReading, Step


@dataclass
class GaussianSplatting(Method):
    """L = weight · ((1 − λ_ssim) L1 + λ_ssim (1 − SSIM) + λ_smooth L_smooth): 3DGS, eq. 7; ThermalGaussian.

    The weight hardly affects Adam, but density control. In MSMG it is 0.6 × the RGB model's share in all Gaussians.
    """

    lambda_ssim: Share
    lambda_smooth: NonNegativeFloat
    smoothness_reading: SmoothnessReading
    weight: NonNegativeFloat

    def setup(self, context: Context) -> None:
        self.model = context.gaussians()
        self.views = context.views()

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.model.render(view.camera)
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = thermal_loss(render.image, target, self.lambda_ssim, self.lambda_smooth, self.smoothness_reading, valid)
        return Step(self.weight * loss, {"thermal": loss}, render, target, valid)
