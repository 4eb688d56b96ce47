"""Plain 3DGS (Kerbl et al. 2023) on thermal images alone: shows what the depth prior and the smoothness bring."""

from __future__ import annotations

import torch

from tdgbench.scenes import Camera
from tdgbench.training.losses import photometric
from tdgbench.training.method import Context, Step, thermal_tensor
from tdgbench.training.model import Render, SplatModel


class Splat:
    """L = (1 − λ) L1 + λ (1 − SSIM): 3DGS, eq. 7."""

    name = "splat"
    needs_rgb = False
    needs_prior = False

    def __init__(self, lambda_ssim: float) -> None:
        self.lambda_ssim = lambda_ssim

    def setup(self, context: Context) -> None:
        self.model = context.make_model(context.scene.channels, thermal_tensor)
        self.views = context.view_order()

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.model.render(view.camera)
        target = thermal_tensor(view, render.image.device)
        loss = photometric(render.image, target, self.lambda_ssim)
        return Step(loss, {"thermal": loss.item()}, render, target)

    def models(self) -> dict[str, SplatModel]:
        return {"thermal": self.model}

    @torch.no_grad()
    def render(self, camera: Camera) -> Render:
        return self.model.render(camera, depth=True)
