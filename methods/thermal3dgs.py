"""Thermal3D-GS (Chen et al. 2024): thermal images with networks of atmospheric transmission and thermal conduction.

As released (mzzcdf/Thermal3DGS, commit 03366b2a). There the corner weight is 1 where the render is flat and 0 at edges
(no window sums the structure tensor, so that its determinant is 0), and the conduction module is zero for good in about
half of its random starts, else a brightness of about 1/√height.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from pydantic import PositiveFloat
from torch import Tensor
from torch.nn import functional as F

from methods.deformable import ADAM, Trunk, encoded, encoded_size, falling, seconds_of
from tdgbench.splats import Gaussians
from tdgbench.splats.geometry import seen_colors
from tdgbench.splats.torch_losses import without_masked
from tdgbench.splats.view import GaussianTensors, Pinhole, Render
from tdgbench.training.context import Context
from tdgbench.training.images import THERMAL
from tdgbench.training.losses import l1_and_dssim
from tdgbench.training.method import FirstAndLast, Frame, Method, Share, Step
from tdgbench.training.part import Network, State

HARRIS = 0.04  # find_corners


class Transmission(Trunk):
    """ATF: the factor of a Gaussian's colour at a time, exp((a + s) d), of its place; utils/ATF_utils.py.

    Three heads a, s and d without activation.
    """

    def __init__(self, width: int = 256) -> None:
        super().__init__(encoded_size(4), width)
        self.absorption, self.distance, self.scattering = (torch.nn.Linear(width, 1) for _ in range(3))

    def forward(self, means: Tensor, time: float) -> Tensor:
        """Return the factor (N, 1) of Gaussians at means (N, 3), world units, at a time in [0, 1]."""
        times = torch.full_like(means[:, :1], time)
        hidden = self.hidden(torch.cat([encoded(means), encoded(times)], dim=1))
        factor: Tensor = torch.exp((self.absorption(hidden) + self.scattering(hidden)) * self.distance(hidden))
        return factor


class Conduction(torch.nn.Module):
    """TCM: what is added to all channels of a render, from its first one; utils/TCM_utils.py.

    Three 1×1 convolutions of the image and its second differences, each followed by the normalisation of every image
    column and ReLU.
    """

    def __init__(self) -> None:
        super().__init__()
        self.layers = torch.nn.ModuleList(torch.nn.Conv2d(inputs, 1, kernel_size=1) for inputs in (2, 1, 1))

    def forward(self, image: Tensor) -> Tensor:
        """Return what is added (H, W, 1) to an image (H, W, C)."""
        first = image[..., 0]
        edges = sum(torch.gradient(torch.gradient(first, dim=axis)[0], dim=axis)[0].abs() for axis in (1, 0))
        values = torch.stack([first, torch.as_tensor(edges)])
        for layer in self.layers:
            values = F.relu(F.normalize(layer(values), dim=1))
        return values.permute(1, 2, 0)


class ConductionPart(Network):
    """The conduction module in training; it reports whether it does anything."""

    def __init__(self, module: Conduction, rate: Any) -> None:
        super().__init__(module, rate, ADAM)
        self.largest = torch.zeros(())  # that it added to the last image

    def added(self, image: Tensor) -> Tensor:
        """Return an image (H, W, C) with what the module adds."""
        added = self.module(image)
        self.largest = added.detach().amax()
        return image + added

    def state_dict(self) -> State:
        return {**super().state_dict(), "largest": self.largest}

    def load_state_dict(self, saved: State) -> None:
        super().load_state_dict(saved)
        self.largest = saved.get("largest", self.largest)  # cells that were stored before lack it

    def report(self) -> dict[str, Any]:
        largest = self.largest.item()
        return {**super().report(), "adds_at_most": largest, "dead": largest == 0.0}


@dataclass
class Thermal3DGS(Method):
    """L = (1 − λ_ssim − λ_corner) L1 + λ_ssim (1 − SSIM) + λ_corner max(1 − t / corner_end, 0) L_corner."""

    renders_plain_gaussians = False
    keeps_full_resolution = True  # what conduction adds depends on the number of rows

    lambda_ssim: Share
    lambda_corner: Share
    corner_end: Share  # of all iterations
    transmission: bool  # whether there is such a network
    conduction: bool
    transmission_rates: FirstAndLast  # first and last; they fall log-linearly, as the position rate does
    conduction_rates: FirstAndLast
    position_unit: PositiveFloat | None  # world units; None: the scene's extent

    def setup(self, context: Context) -> None:
        self.model, self.views = context.gaussians(position_unit=self.position_unit), context.views()
        self.frame, self.corner_until = context.frame, self.corner_end * context.budget.schedule_length
        steps = context.budget.rates.means_steps
        torch.manual_seed(context.seed)
        self.atf = self.tcm = None
        if self.transmission:
            rate = falling(self.transmission_rates, steps)
            self.atf = context.add_part("transmission", Network(Transmission().to(context.device), rate, ADAM))
        if self.conduction:
            rate = falling(self.conduction_rates, steps)
            self.tcm = context.add_part("conduction", ConductionPart(Conduction().to(context.device), rate))

    def step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self._rendered(self.frame(view))
        target, valid = THERMAL.tensors_of(view, render.image.device)
        weight = self.lambda_corner * max(1 - iteration / max(self.corner_until, 1), 0.0)
        loss = l1_and_dssim(render.image, target, 1 - self.lambda_ssim - self.lambda_corner, self.lambda_ssim, valid)
        terms = {"thermal": loss}
        if weight > 0:
            corner = corner_loss(render.image, target, valid)
            loss, terms["corner"] = loss + weight * corner, corner
        return Step(loss, terms, render, target, valid)

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        return self._rendered(frame, depth=True)

    def step_seconds(self) -> float:
        if self.atf is None:
            return 0.0
        module = self.atf.module
        return seconds_of(lambda means: module(means, 0.0), module.parameters(), self.model.gaussians.means)

    def _rendered(self, frame: Frame, depth: bool = False) -> Render:
        def hook(gaussians: Gaussians, degree: int) -> GaussianTensors:
            return transmitted(gaussians, degree, camera.to(gaussians.means), network, frame.time)

        network, camera = None if self.atf is None else self.atf.module, Pinhole.of(self.model.camera(frame.camera))
        render = self.model.render(frame.camera, depth=depth, hook=None if network is None else hook)
        if self.tcm is not None:
            render.image = self.tcm.added(render.image)
        return render


def transmitted(
    gaussians: Gaussians, degree: int, camera: Pinhole, network: torch.nn.Module | None, time: float
) -> GaussianTensors:
    """Return Gaussians with colours times the network's factor, which is left at 1 where the camera does not look."""
    means, active = gaussians.means, gaussians.activated(degree)
    colors = seen_colors(active, slice(None), camera)
    seen = in_sight(means.detach(), active.scales.detach(), camera)
    factor = torch.ones_like(colors[:, :1])
    if network is not None and len(seen):
        factor = factor.index_put((seen,), network(means[seen].detach(), time))
    return active._replace(colors=colors * factor, sh_degree=None)


def in_sight(means: Tensor, scales: Tensor, camera: Pinhole) -> Tensor:
    """Return the indices of all Gaussians that may reach the image, and of few others."""
    x, y, z = (means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]).unbind(1)
    reach = 4 * scales.amax(dim=1)  # the rasteriser's 3 σ, and the blur of its EWA filter
    near = z.clamp_min(camera.near_plane)
    sides = []
    for across, focal, at, size in (
        (x, camera.K[0, 0], camera.K[0, 2], camera.width),
        (y, camera.K[1, 1], camera.K[1, 2], camera.height),
    ):
        px, radius = across / near * focal + at, 2 * reach / near * focal + 3
        sides.append((px + radius > 0) & (px - radius < size))
    return ((z > camera.near_plane) & sides[0] & sides[1]).nonzero().squeeze(1)


def corner_loss(image: Tensor, target: Tensor, valid: Tensor | None = None) -> Tensor:
    """Return the mean of |image − target| · w over valid pixels, w = exp(R) / max exp(R); images (H, W, C) in [0, 1].

    R = det M − 0.04 (tr M)², with M of the Sobel responses Ix, Iy of the image in 0 to 255, summed over three channels
    (`corners_loss`). No window sums M, so that R = −0.04 (Ix² + Iy²)²: w is 1 where the render is flat. The gradient
    also flows through w.
    """
    if valid is not None:
        image = without_masked(image, valid)  # 0, as beyond the border
    gray = 255 * (image.sum(dim=2) if image.shape[2] == 3 else 3 * image[..., 0])
    kernel = image.new_tensor([[-1.0, -2.0, -1.0], [0.0, 0.0, 0.0], [1.0, 2.0, 1.0]])
    padded = F.pad(gray[None, None], (1, 1, 1, 1))
    responses = F.conv2d(padded, torch.stack([kernel, kernel.T])[:, None])[0]
    strength = -HARRIS * responses.square().sum(dim=0).square()
    weight = torch.exp(strength - (strength if valid is None else strength[valid]).max())
    weighted = (image - target).abs().mean(dim=2) * weight
    return weighted.mean() if valid is None else weighted[valid].mean()
