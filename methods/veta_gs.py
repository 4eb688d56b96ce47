"""Veta-GS (Nam et al. 2025): a network moves, turns and grows the Gaussians by view and time; a loss of three features.

As released (nbril0313/Veta-GS, commit e7e56af0). There the network gets the world's z axis in camera coordinates in the
place of a viewing direction, and the similarity of spectra sends no gradient to the render.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from pydantic import NonNegativeFloat, PositiveFloat
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn import functional as F

from methods.canny import canny
from methods.deformable import ADAM, Trunk, encoded, encoded_size, falling, seconds_of
from tdgbench.splats import Gaussians
from tdgbench.splats.geometry import multiply_quaternions, seen_colors, visible_radii
from tdgbench.splats.view import GaussianTensors, Pinhole, Render
from tdgbench.training.context import Context
from tdgbench.training.images import THERMAL
from tdgbench.training.losses import l1_and_dssim, photometric
from tdgbench.training.method import FirstAndLast, Frame, Method, Share, Step
from tdgbench.training.part import Network

LOW, HIGH = 100, 200  # Canny's thresholds: utils/loss_utils.py, lines 107 and 108

TIED = 1e-5  # of the axes' variances: closer ones have no gradient of their directions left in float32


class Deformation(Trunk):
    """What is added to means, quaternions and scales, by place, time, camera centre and direction (time_utils.py)."""

    applied: Tensor  # whether the warm-up is over

    def __init__(self, width: int = 256) -> None:
        super().__init__(encoded_size(4) + 6, width)
        self.means, self.quats, self.scales = (torch.nn.Linear(width, size) for size in (3, 4, 3))
        self.register_buffer("applied", torch.zeros((), dtype=torch.bool))

    def forward(self, means: Tensor, time: float, center: Tensor, direction: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return what is added to means (N, 3), quaternions (N, 4) and scales (N, 3); center, direction (3,)."""
        view = torch.cat([center, direction]).expand(len(means), -1)
        hidden = self.hidden(torch.cat([encoded(means), encoded(torch.full_like(means[:, :1], time)), view], dim=1))
        return self.means(hidden), self.quats(hidden), self.scales(hidden)


class MonoSSIM(torch.nn.Module):
    """(1 − l)(1 − s)(1 − e): l of spectra, s of images, e of edges, each by 16 feature maps of a network of its own."""

    def __init__(self) -> None:
        super().__init__()
        self.edges, self.images, self.spectra = (_feature_maps() for _ in range(3))

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        """Return the loss of images (H, W, C): edges and similarity by the first channel, spectra by the last.

        As released (utils/loss_utils.py, line 48), the spectrum is that of a copy, without gradient.
        """
        spectra = similarity(self.spectra, spectrum(image.detach()[..., -1]), spectrum(target[..., -1]))
        images = similarity(self.images, image[..., 0], target[..., 0])
        edges = similarity(self.edges, edge_map(image[..., 0]), edge_map(target[..., 0]))
        return (1 - spectra) * (1 - images) * (1 - edges)


def _feature_maps() -> torch.nn.Sequential:
    layers = [torch.nn.Conv2d(inputs, 16, 3, padding=1) for inputs in (1, 16)]
    return torch.nn.Sequential(layers[0], torch.nn.ReLU(), layers[1], torch.nn.ReLU())


def similarity(network: torch.nn.Module, a: Tensor, b: Tensor) -> Tensor:
    """Return the mean of (cos + 1) / 2 over a network's maps of two images (H, W)."""
    one, other = (network(image[None, None])[0].flatten(1) for image in (a, b))
    return ((F.cosine_similarity(one, other, dim=1) + 1) / 2).mean()


def spectrum(image: Tensor) -> Tensor:
    """Return log(|FFT| + 1) of an image (H, W), frequency 0 in the middle."""
    shifted: Tensor = torch.fft.fftshift(torch.fft.fft2(image))
    return torch.log(shifted.abs() + 1)


def edge_map(image: Tensor) -> Tensor:
    """Return Canny's edges (H, W) of an image, 1 or 0. Its 8-bit values wrap around above 1, as in the original."""
    levels = (255 * image.detach()).to(torch.int32).bitwise_and(255).cpu().numpy().astype(np.uint8)
    return torch.from_numpy(canny(levels, LOW, HIGH)).to(image)


@dataclass
class VetaGS(Method):
    """L = (1 − λ_ssim) L1 + λ_ssim (1 − SSIM); later L1 weighs λ_mono less, and λ_mono L_mono is added."""

    renders_plain_gaussians = False

    lambda_ssim: Share
    lambda_mono: Share
    mono_start: Share  # of all iterations
    warm_up: Share  # of all iterations
    time_noise: NonNegativeFloat  # at the start, × the time between the views that are left in a round
    time_noise_end: Share  # of all iterations
    deformation_rates: FirstAndLast  # first and last, log-linear
    feature_rates: FirstAndLast
    position_unit: PositiveFloat | None  # world units; None: the scene's extent

    def setup(self, context: Context) -> None:
        self.model, self.views = context.gaussians(position_unit=self.position_unit), context.views()
        self.frame, self.iterations = context.frame, context.budget.schedule_length
        self.noise = context.random("time_noise")
        steps = context.budget.rates.means_steps
        torch.manual_seed(context.seed)
        self.deformation, self.features = Deformation(), MonoSSIM()
        for name, module, rates in (
            ("deformation", self.deformation, self.deformation_rates),
            ("features", self.features, self.feature_rates),
        ):
            context.add_part(name, Network(module.to(context.device), falling(rates, steps), ADAM))

    def step(self, iteration: int) -> Step:
        view, noise = self.views.next(), 0.0
        if iteration >= self.warm_up * self.iterations:
            self.deformation.applied.fill_(True)
            noise = torch.randn((), generator=self.noise).item() * self.noise_at(iteration, self.views.left + 1)
        render = self._rendered(self.frame(view), noise, of_visible=True)
        target, valid = THERMAL.tensors_of(view, render.image.device)
        if iteration <= self.mono_start * self.iterations:
            loss = photometric(render.image, target, self.lambda_ssim, valid)
            return Step(loss, {"thermal": loss}, render, target, valid)
        l1_weight = 1 - self.lambda_ssim - self.lambda_mono
        loss = l1_and_dssim(render.image, target, l1_weight, self.lambda_ssim, valid)
        compared = render.image if valid is None else render.image * valid[..., None]
        mono = self.features(compared, target)
        terms = {"thermal": loss, "mono": mono}
        return Step(loss + self.lambda_mono * mono, terms, render, target, valid)

    def noise_at(self, iteration: int, views_left: int) -> float:
        """Return the standard deviation of the time at an iteration, with so many views left in the round."""
        return self.time_noise * max(1 - iteration / max(self.time_noise_end * self.iterations, 1), 0.0) / views_left

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        return self._rendered(frame, depth=True)

    def step_seconds(self) -> float:
        zeros = self.model.gaussians.means.new_zeros(3)
        return seconds_of(
            lambda means: torch.cat(self.deformation(means, 0.0, zeros, zeros), dim=1),
            self.deformation.parameters(),
            self.model.gaussians.means,
        )

    def _rendered(self, frame: Frame, noise: float = 0.0, of_visible: bool = False, depth: bool = False) -> Render:
        def hook(gaussians: Gaussians, degree: int) -> GaussianTensors:
            camera = Pinhole.of(self.model.camera(frame.camera)).to(gaussians.means)
            index = torch.arange(len(gaussians), device=gaussians.means.device)
            if of_visible:
                index = visible_radii(gaussians.detach().activated(degree), camera).nonzero().squeeze(1)
            view = (center_of(camera), direction_of(camera))
            changes = self.deformation(gaussians.means[index].detach(), frame.time + noise, *view)
            return deformed(gaussians, degree, camera, index, changes)

        return self.model.render(frame.camera, depth=depth, hook=hook if self.deformation.applied else None)


def center_of(camera: Pinhole) -> Tensor:
    """Return the camera's centre (3,), world."""
    return -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3]


def direction_of(camera: Pinhole) -> Tensor:
    """Return the direction (3,) that the network gets: minus the third column of the world-to-camera rotation.

    That is the world's z axis in camera coordinates, turned round (train.py, line 116).
    """
    return -camera.viewmat[:3, 2]


def deformed(
    gaussians: Gaussians, degree: int, camera: Pinhole, index: Tensor, changes: tuple[Tensor, Tensor, Tensor]
) -> GaussianTensors:
    """Return Gaussians with changes of mean (n, 3), unit quaternion (n, 4) and scale (n, 3) at an index (n,).

    Colours are those of the directions to the undeformed means (gaussian_renderer, line 101).
    """
    active = gaussians.activated(degree)
    colors = seen_colors(active, slice(None), camera)
    means, turned, scales = (
        values.index_add(0, index, change)
        for values, change in zip((active.means, F.normalize(active.quats, dim=1), active.scales), changes, strict=True)
    )
    quats, lengths = principal_axes(stretched_rotations(turned[index]) * scales[index][:, None, :])
    quats, scales = turned.index_copy(0, index, quats), scales.index_copy(0, index, lengths)
    return active._replace(means=means, quats=quats, scales=scales, colors=colors, sh_degree=None)


def stretched_rotations(quats: Tensor) -> Tensor:
    """Return matrices (N, 3, 3) of quaternions (N, 4) wxyz by 3DGS's formula, which does not divide by their length.

    Where |q| is not 1 they are no rotations R: (1 − |q|²) I + |q|² R.
    """
    w, x, y, z = quats.unbind(1)
    zero = torch.zeros_like(w)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)
    outer = quats[:, 1:, None] * quats[:, None, 1:]
    diagonal = torch.diag_embed((1 - 2 * (x * x + y * y + z * z))[:, None].expand(-1, 3))
    return diagonal + 2 * (outer + w[:, None, None] * cross)


def principal_axes(matrices: Tensor) -> tuple[Tensor, Tensor]:
    """Return unit quaternions (N, 4) and scales (N, 3) of Gaussians with covariances M Mᵀ, M (N, 3, 3).

    Thus a backend renders any M, with gradients, whatever it does to rotations.
    """
    return _PrincipalAxes.apply(matrices)


class _PrincipalAxes(torch.autograd.Function):
    @staticmethod
    def forward(ctx, matrices):
        if len(matrices) == 0 or not torch.isfinite(matrices).all():  # the render is not finite, and the loop says so
            ctx.saved = None
            return matrices.new_full((len(matrices), 4), torch.nan), matrices.new_full((len(matrices), 3), torch.nan)
        wide = matrices.double()
        variances, axes = torch.linalg.eigh(wide @ wide.mT)
        axes[:, :, 0] *= torch.linalg.det(axes).sign()[:, None]
        quats = np.roll(Rotation.from_matrix(axes.cpu().numpy()).as_quat(), 1, axis=1)
        scales = variances.clamp_min(0).sqrt()
        ctx.saved = (wide, axes, scales, torch.from_numpy(quats).to(wide))
        return ctx.saved[3].to(matrices), scales.to(matrices)

    @staticmethod
    def backward(ctx, grad_quats, grad_scales):
        """A covariance that changes by dC turns its axes i, j by dC_ij / (λ_j − λ_i), all along these axes."""
        if ctx.saved is None:
            return grad_scales.new_full((len(grad_scales), 3, 3), torch.nan)
        wide, axes, scales, quats = ctx.saved
        variances = scales.square()
        conjugate = quats * quats.new_tensor([1.0, -1.0, -1.0, -1.0])
        turn = multiply_quaternions(conjugate, grad_quats.double())[:, 1:] / 2
        inner = torch.diag_embed(grad_scales.double() / (2 * scales.clamp_min(1e-30)))
        for i, j, around, sign in ((0, 1, 2, -1), (0, 2, 1, 1), (1, 2, 0, -1)):
            gap = variances[:, j] - variances[:, i]
            least = (TIED * variances[:, j]).square().clamp_min(1e-60)
            inner[:, i, j] = inner[:, j, i] = sign * turn[:, around] * gap / (2 * (gap.square() + least))
        return (2 * axes @ inner @ axes.mT @ wide).to(grad_quats)
