"""One Gaussian model on thermal images alone: plain 3DGS (Kerbl et al. 2023), or the thermal model of MSMG.

3DGS compared with TDg shows the gain of depth and smoothness; MSMG's model compared with MSMG that of leaving out RGB.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pydantic import NonNegativeFloat

from tdgbench.scenes import View
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.images import RGB, THERMAL
from tdgbench.training.losses import photometric, thermal_loss
from tdgbench.training.method import Method, Share, SmoothnessReading, Step


@dataclass
class ThermalGaussianLosses(Method):
    """L_rgb is 3DGS's loss (eq. 7), L_thermal that of ThermalGaussian: the same, and λ_smooth × smoothness."""

    lambda_ssim: Share
    lambda_smooth: NonNegativeFloat
    smoothness_reading: SmoothnessReading

    def thermal_step(self, render: Render, view: View) -> Step:
        """Return L_thermal = (1 − λ_ssim) L1 + λ_ssim (1 − SSIM) + λ_smooth L_smooth of a render of a view."""
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = thermal_loss(render.image, target, self.lambda_ssim, self.lambda_smooth, self.smoothness_reading, valid)
        return Step(loss, {"thermal": loss}, render, target, valid)

    def rgb_step(self, render: Render, view: View) -> Step:
        """Return L_rgb = (1 − λ_ssim) L1 + λ_ssim (1 − SSIM) of a render of a view."""
        target, _ = RGB.tensors_of(view, render.image.device)
        loss = photometric(render.image, target, self.lambda_ssim)
        return Step(loss, {"rgb": loss}, render, target)


@dataclass
class GaussianSplatting(ThermalGaussianLosses):
    """L = weight · L_thermal.

    The weight hardly affects Adam, but density control. In MSMG it is 0.6 × the RGB model's share in all Gaussians.
    """

    weight: NonNegativeFloat

    def setup(self, context: Context) -> None:
        self.model = context.gaussians()
        self.views = context.views()

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        step = self.thermal_step(self.model.render(view.camera), view)
        return replace(step, loss=self.weight * step.loss)
