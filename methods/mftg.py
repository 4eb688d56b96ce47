"""MFTG, multimodal fine-tuning Gaussians: RGB first, then thermal images (ThermalGaussian, Lu et al. 2024).

The paper starts the thermal stage from the RGB model. The released code (chen-hangyu/Thermal-Gaussian-main, commit
050c2915, train_MFTG.py, line 46) starts it from the point cloud again, of which `Scene_2` makes new Gaussians; only the
SH degree in use stays that of the RGB model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import torch
from pydantic import Field

from methods.gaussian_splatting import ThermalGaussianLosses
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.method import Frame, Stage, Step


@dataclass
class MFTG(ThermalGaussianLosses):
    """First L_rgb, then L_thermal.

    Optimiser, learning rates and density control begin anew with the second stage.
    """

    modalities = ("thermal", "rgb")

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
        return self.rgb_step(self.rgb.render(view.camera), view)

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
        return self.thermal_step(self.thermal.render(view.camera), view)

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        model = self.rgb if modality == "rgb" else self.thermal  # of the stages so far
        return model.render(frame.camera, depth=modality == "thermal")
