"""The `reference` backend: splatting in plain torch, for any float type and device. Slow; for small scenes.

It states the mathematics without tiles, boxes or shortcuts; all other backends are tested against it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.blending import Blending
from tdgbench.splats.harmonics import colors_from_sh
from tdgbench.splats.view import GaussianTensors, Pinhole, Projection, Render, RenderOptions

TILE = 16
PAIRS_AT_ONCE = 4_000_000  # pixel-Gaussian pairs in memory


def rotation_matrices(quats: Tensor) -> Tensor:
    """Return rotations (N, 3, 3) of quaternions (N, 4) wxyz of any length."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def project(means, quats, scales, viewmat, K, width, height, eps2d) -> tuple[Tensor, ...]:
    """Project Gaussians (EWA) to image means (N, 2) px, conics (N, 3) px⁻², covariances (N, 2, 2) px² and depths (N,).

    means (N, 3), quats (N, 4), scales (N, 3), viewmat (4, 4), K (3, 3) px.
    """
    points = means @ viewmat[:3, :3].T + viewmat[:3, 3]
    x, y, z = points.unbind(-1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    tx = (x / z).clamp((-cx / fx - margin_x).item(), ((width - cx) / fx + margin_x).item())
    ty = (y / z).clamp((-cy / fy - margin_y).item(), ((height - cy) / fy + margin_y).item())
    zero = torch.zeros_like(z)
    rows = [torch.stack([fx / z, zero, -fx / z * tx], dim=-1), torch.stack([zero, fy / z, -fy / z * ty], dim=-1)]
    to_image = torch.stack(rows, dim=-2) @ viewmat[:3, :3]
    axes = to_image @ rotation_matrices(quats) * scales[:, None, :]
    covariance = axes @ axes.transpose(-1, -2) + eps2d * torch.eye(2, dtype=means.dtype, device=means.device)
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    det = a * c - b * b
    conics = torch.stack([c, -b, a], dim=-1) / det[:, None]
    means2d = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=-1)
    return means2d, conics, covariance, z


def _screen_radii(means2d, covariance, width, height) -> Tensor:
    """Return 3DGS's radii (N,) px: 3 σ, rounded up; 0 if the square misses the grid of 16×16 tiles."""
    mid = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])
    spread = (mid * mid - torch.linalg.det(covariance)).clamp_min(0.1).sqrt()
    radii = (3.0 * (mid + spread).sqrt()).ceil()
    x, y = (means2d - 0.5).unbind(-1)
    grid_width, grid_height = -(-width // TILE) * TILE, -(-height // TILE) * TILE
    visible = (x + radii >= 1) & (y + radii >= 1) & (x - radii < grid_width) & (y - radii < grid_height)
    return torch.where(visible, radii, 0.0).clamp_max(1e9).to(torch.int32)


@torch.no_grad()
def visible_radii(gaussians: GaussianTensors, camera: Pinhole) -> Tensor:
    """Return 3DGS's radii (N,) int32 px of Gaussians on the image of a camera; 0: not visible. Nothing is rendered."""
    means, quats, scales = gaussians[:3]
    camera = camera.to(means)
    depths = means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    seen = (depths > camera.near_plane) & (depths < camera.far_plane)
    means2d, _, covariance, _ = project(means[seen], quats[seen], scales[seen], *camera[:4], camera.eps2d)
    radii = torch.zeros(len(means), dtype=torch.int32, device=means.device)
    radii[seen] = _screen_radii(means2d, covariance, camera.width, camera.height)
    return radii


def blend(pixels, means2d, conics, opacities, channels, blending, observe=None) -> tuple[Tensor, Tensor]:
    """Return light (P, D) and transmittance (P,) at pixel centres (P, 2) px, of Gaussians sorted from near to far.

    means2d (N, 2) px, conics (N, 3) px⁻², opacities (N,), channels (N, D). The backward pass calls observe(gradients
    (P, N, 2) of the negative image means, by pixel).
    """
    d = pixels[:, None, :] - means2d[None]
    if observe is not None and d.requires_grad:
        d.register_hook(observe)
    quadratic = conics[:, 0] * d[..., 0] ** 2 + conics[:, 2] * d[..., 1] ** 2
    power = -0.5 * quadratic - conics[:, 1] * d[..., 0] * d[..., 1]
    alpha = (opacities * power.exp()).clamp_max(blending.max_alpha)
    alpha = torch.where(alpha >= blending.min_alpha, alpha, 0.0)
    after = (1 - alpha).cumprod(dim=1)
    # `after` never grows: all Gaussians behind the stop are skipped
    alpha = torch.where(after >= blending.min_transmittance, alpha, 0.0)
    after = (1 - alpha).cumprod(dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    return (alpha * before) @ channels, after[:, -1]


class ReferenceBackend(Backend):
    """Any float tensors on any device, with autograd's gradients. The image means are part of the graph."""

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        means, quats, scales, opacities, _, _ = gaussians
        camera = camera.to(means)
        depths = means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        in_front = ((depths > camera.near_plane) & (depths < camera.far_plane)).nonzero().squeeze(1)
        means2d, conics, covariance, z = project(
            means[in_front], quats[in_front], scales[in_front], camera.viewmat, camera.K, camera.width, camera.height,
            camera.eps2d,
        )  # fmt: skip
        radii = torch.zeros(len(means), dtype=torch.int32, device=means.device)
        radii[in_front] = _screen_radii(means2d.detach(), covariance.detach(), camera.width, camera.height)
        zeros = torch.zeros(len(means), 2, dtype=means.dtype, device=means.device)
        all_means2d = zeros.index_put((in_front,), means2d)
        if all_means2d.requires_grad:
            all_means2d.retain_grad()
        channels = seen_colors(gaussians, in_front, camera)
        if options.depth:
            channels = torch.cat([channels, z[:, None]], dim=1)
        order = torch.argsort(z.detach(), stable=True)
        splats = (all_means2d[in_front][order], conics[order], opacities[in_front][order], channels[order])
        absgrad, observe = None, None
        if options.absgrad:
            absgrad = torch.zeros_like(zeros)
            observe = partial(_add_absolute, absgrad, in_front[order])
        light, transmittance = _blend_image(splats, camera, options.blending, observe)
        if bool(torch.stack([t.isnan().any() for t in (means, quats, scales, opacities)]).any()):
            light, transmittance = light * torch.nan, transmittance * torch.nan  # its place in the image is unknown
        image, depth = (light[..., :-1], light[..., -1]) if options.depth else (light, None)
        if options.background is not None:
            image = image + transmittance[..., None] * options.background.to(means.dtype)
        return Render(image, depth, transmittance, Projection(all_means2d, radii, depths.detach(), absgrad))


def _add_absolute(total: Tensor, index: Tensor, gradients: Tensor) -> None:
    """Add to total (N, 2), at an index (n,), the sums over pixels of the absolute gradients (P, n, 2)."""
    total.index_add_(0, index, gradients.abs().sum(dim=0))


def seen_colors(gaussians: GaussianTensors, index: Tensor | slice, camera: Pinhole) -> Tensor:
    """Return colours (n, D) of the Gaussians at an index (n,), as the camera sees them."""
    if gaussians.sh_degree is None:
        return gaussians.colors[index]
    centre = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3]
    directions = torch.nn.functional.normalize(gaussians.means[index] - centre, dim=-1)
    return colors_from_sh(gaussians.colors[index], directions, gaussians.sh_degree)


def _blend_image(
    splats: tuple[Tensor, Tensor, Tensor, Tensor],
    camera: Pinhole,
    blending: Blending,
    observe: Callable[[Tensor], None] | None = None,
) -> tuple[Tensor, Tensor]:
    """Return light (H, W, D) and transmittance (H, W) of means2d, conics, opacities and channels; see `blend`."""
    means2d, _, _, channels = splats
    ys, xs = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    pixels = torch.stack([xs, ys], dim=-1).reshape(-1, 2).to(means2d.device, means2d.dtype) + 0.5
    if len(means2d) == 0:
        light = channels.new_zeros(len(pixels), 1) + channels.sum(dim=0) * 0.0  # keeps the graph
        transmittance = torch.ones(len(pixels), dtype=means2d.dtype, device=means2d.device)
    else:
        chunks = pixels.split(max(1, PAIRS_AT_ONCE // len(means2d)))
        parts = [blend(chunk, *splats, blending, observe) for chunk in chunks]
        light = torch.cat([part[0] for part in parts])
        transmittance = torch.cat([part[1] for part in parts])
    return light.reshape(camera.height, camera.width, -1), transmittance.reshape(camera.height, camera.width)


BACKEND = ReferenceBackend()
