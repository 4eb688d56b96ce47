"""OMMG, one multimodal Gaussian model: two colour sets on one geometry (ThermalGaussian, Lu et al. 2024).

As released (chen-hangyu/Thermal-Gaussian-main, branch OMMG, commit 5d3243ac, train-OMMG.py): one rasterisation blends
both colour sets with the same weights, so that density control reads the gradient of the weighted sum of both losses.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.scenes import Scene, View
from tdgbench.splats.gaussians import RenderedFields
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.method import Frame, Step

SH_RGB = "sh_rgb"  # the further field
BOTH_COLORS, RGB_COLORS = RenderedFields(("sh", SH_RGB)), RenderedFields((SH_RGB,))


class OMMG(GaussianSplatting):
    """L = weight · (L_rgb + L_thermal).

    Both colour sets start from the points' colours. RGB renders are over black.
    """

    modalities = ("thermal", "rgb")
    renders_plain_gaussians = False
    keeps_all_points = True
    can_learn_rig = False  # one camera shows both images

    def rendered_channels(self, scene: Scene) -> set[int]:
        return super().rendered_channels(scene) | {scene.channels + 3}  # both images in one pass

    def setup(self, context: Context) -> None:
        points, degree = context.points, context.budget.sh_degree
        sh_rgb = gaussians_from_points(points.points, points.colors, 3, degree).sh
        self.model = context.gaussians(extra_fields={SH_RGB: sh_rgb}, learning_rates={SH_RGB: "sh"})
        self.views = context.views()

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.model.render(view.camera, hook=BOTH_COLORS, background=self._background())
        channels = self.model.state.channels
        render.image, rgb = render.image.split([channels, 3], dim=2)
        return self._compared(view, render, rgb)

    def _compared(self, view: View, render: Render, rgb: Tensor) -> Step:
        """Return the loss of a view's thermal render and RGB image (H, W, 3)."""
        thermal = self.thermal_step(render, view)
        of_rgb = self.rgb_step(replace(render, image=rgb), view).loss
        return replace(thermal, loss=self.weight * (of_rgb + thermal.loss), terms={"rgb": of_rgb, **thermal.terms})

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        if modality == "rgb":
            black = self.model.state.values.new_zeros(3)
            return self.model.render(frame.camera, hook=RGB_COLORS, background=black)
        return self.model.render(frame.camera, depth=True)

    def _background(self) -> Tensor | None:
        """Return what is behind both images (C + 3,); None: black."""
        behind = self.model.background
        return None if behind is None else torch.cat([behind, behind.new_zeros(3)])
