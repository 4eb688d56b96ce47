"""MFTG, multimodal fine-tuning Gaussians: RGB first, then thermal images (ThermalGaussian, Lu et al. 2024).

The paper starts the thermal stage from the RGB model. The released code (chen-hangyu/Thermal-Gaussian-main, commit
050c2915, train_MFTG.py, line 46) starts it from the point cloud again, of which `Scene_2` makes new Gaussians; only the
SH degree in use stays that of the RGB model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import torch
from pydantic import Field, NonNegativeFloat

from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.images import RGB, THERMAL
from tdgbench.training.losses import photometric, thermal_loss
from tdgbench.training.method import Frame, Method, Share, SmoothnessReading, Stage, Step


@dataclass
class MFTG(Method):
    """First L_rgb, 3DGS's loss (eq. 7); then L_thermal, that of ThermalGaussian with smoothness.

    Optimiser, learning rates and density control begin anew with the second stage.
    """

    modalities = ("thermal", "rgb")

    lambda_ssim: Share
    lambda_smooth: NonNegativeFloat
    smoothness_reading: SmoothnessReading
    rgb_share: Annotated[float, Field(gt=0, lt=1)]  # of the iterations
    start: Literal["cloud", "rgb_model"]  # of the thermal stage

    def stages(self) -> list[Stage]:
        return [
            Stage("rgb", self._set_up_rgb, self._step_rgb, self.rgb_share, "rgb"),
            Stage("thermal", self._set_up_thermal, self._step_thermal, 1 - self.rgb_share),
        ]

    def _set_up_rgb(self, context: Context) -> None:
        self.rgb, self.views = context.gaussians("rgb"), context.views()

    def _step_rgb(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.rgb.render(view.camera)
        target, _ = RGB.tensors_of(view, render.image.device)
        loss = photometric(render.image, target, self.lambda_ssim)
        return Step(loss, {"rgb": loss}, render, target)

    def _set_up_thermal(self, context: Context) -> None:
        start = None
        if self.start == "rgb_model":
            start = self.rgb.copy().detach()
            if context.scene.channels == 1:
                start = replace(start, sh=start.sh.mean(dim=2, keepdim=True))
        self.thermal, self.views = context.gaussians(start=start), context.views()
        self.thermal.degree = self.rgb.degree

    def _step_thermal(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.thermal.render(view.camera)
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = thermal_loss(render.image, target, self.lambda_ssim, self.lambda_smooth, self.smoothness_reading, valid)
        return Step(loss, {"thermal": loss}, render, target, valid)

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        model = self.rgb if modality == "rgb" else self.thermal  # of the stages so far
        return model.render(frame.camera, depth=modality == "thermal")
