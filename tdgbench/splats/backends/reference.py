"""The oracle: splatting in plain torch, for any float type, with autograd's own gradients. Slow; for small scenes.

It states the mathematics once, without tiles, boxes or shortcuts; every other backend is tested against it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from tdgbench.splats.harmonics import colors_from_sh
from tdgbench.splats.view import RenderedView

TILE = 16
PAIRS_AT_ONCE = 4_000_000  # pixel-Gaussian pairs held at once, to bound the memory


def rotation_matrices(quats: Tensor) -> Tensor:
    """Rotations (N, 3, 3) of quaternions (N, 4; wxyz), normalised here."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def project(means, quats, scales, viewmat, K, width, height, eps2d) -> tuple[Tensor, ...]:
    """Image means (N, 2), conics (N, 3), 2-D covariances (N, 2, 2) and depths (N,) of all Gaussians (EWA)."""
    points = means @ viewmat[:3, :3].T + viewmat[:3, 3]
    x, y, z = points.unbind(-1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    tx = (x / z).clamp((-cx / fx - margin_x).item(), ((width - cx) / fx + margin_x).item())
    ty = (y / z).clamp((-cy / fy - margin_y).item(), ((height - cy) / fy + margin_y).item())
    zero = torch.zeros_like(z)
    rows = [
        torch.stack([fx / z, zero, -fx / z * tx], dim=-1),
        torch.stack([zero, fy / z, -fy / z * ty], dim=-1),
    ]
    to_image = torch.stack(rows, dim=-2) @ viewmat[:3, :3]
    axes = to_image @ rotation_matrices(quats) * scales[:, None, :]
    covariance = axes @ axes.transpose(-1, -2) + eps2d * torch.eye(2, dtype=means.dtype, device=means.device)
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    det = a * c - b * b
    conics = torch.stack([c, -b, a], dim=-1) / det[:, None]
    means2d = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=-1)
    return means2d, conics, covariance, z


def _screen_radii(means2d, covariance, width, height) -> Tensor:
    """3DGS's radius (px) of each Gaussian: 3 σ, rounded up; 0 if its square misses the grid of 16×16 tiles."""
    mid = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])
    spread = (mid * mid - torch.linalg.det(covariance)).clamp_min(0.1).sqrt()
    radii = (3.0 * (mid + spread).sqrt()).ceil()
    x, y = (means2d - 0.5).unbind(-1)
    grid_width, grid_height = -(-width // TILE) * TILE, -(-height // TILE) * TILE
    seen = (x + radii >= 1) & (y + radii >= 1) & (x - radii < grid_width) & (y - radii < grid_height)
    return torch.where(seen, radii, 0.0).clamp_max(1e9).to(torch.int32)


def blend(pixels, means2d, conics, opacities, channels, blending) -> tuple[Tensor, Tensor]:
    """Light (P, D) and remaining transmittance (P,) of pixel centres (P, 2); Gaussians sorted from near to far."""
    d = pixels[:, None, :] - means2d[None]
    quadratic = conics[:, 0] * d[..., 0] ** 2 + conics[:, 2] * d[..., 1] ** 2
    power = -0.5 * quadratic - conics[:, 1] * d[..., 0] * d[..., 1]
    alpha = (opacities * power.exp()).clamp_max(blending.max_alpha)
    alpha = torch.where(alpha >= blending.min_alpha, alpha, 0.0)
    after = (1 - alpha).cumprod(dim=1)
    # `after` only falls: past the stop all are zero
    alpha = torch.where(after >= blending.min_transmittance, alpha, 0.0)
    after = (1 - alpha).cumprod(dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    return (alpha * before) @ channels, after[:, -1]


def rasterize(means, quats, scales, opacities, colors, viewmat, K, width, height, *, near_plane, far_plane,
              eps2d, sh_degree, background, depth_channel, blending) -> RenderedView:  # fmt: skip
    """Render one camera. The image means are an ordinary member of the graph."""
    dtype = means.dtype
    viewmat, K = viewmat.to(dtype), K.to(dtype)
    depths = means @ viewmat[2, :3] + viewmat[2, 3]
    in_front = ((depths > near_plane) & (depths < far_plane)).nonzero().squeeze(1)
    centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
    front_means = means[in_front]
    means2d, conics, covariance, z = project(
        front_means, quats[in_front], scales[in_front], viewmat, K, width, height, eps2d
    )
    radii = torch.zeros(len(means), dtype=torch.int32, device=means.device)
    radii[in_front] = _screen_radii(means2d.detach(), covariance.detach(), width, height)
    all_means2d = torch.zeros(len(means), 2, dtype=dtype, device=means.device).index_put((in_front,), means2d)
    if all_means2d.requires_grad:
        all_means2d.retain_grad()
    means2d = all_means2d[in_front]

    if sh_degree is None:
        channels = colors[in_front]
    else:
        directions = torch.nn.functional.normalize(front_means - centre, dim=-1)
        channels = colors_from_sh(colors[in_front], directions, sh_degree)
    if depth_channel:
        channels = torch.cat([channels, z[:, None]], dim=1)

    order = torch.argsort(z.detach(), stable=True)
    sorted_args = (means2d[order], conics[order], opacities[in_front][order], channels[order])
    ys, xs = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack([xs, ys], dim=-1).reshape(-1, 2).to(means.device, dtype) + 0.5
    if len(in_front) == 0:
        light = channels.new_zeros(len(pixels), 1) + channels.sum(dim=0) * 0.0  # keeps the graph
        transmittance = torch.ones(len(pixels), dtype=dtype, device=means.device)
    else:
        pieces = pixels.split(max(1, PAIRS_AT_ONCE // len(in_front)))
        parts = [blend(piece, *sorted_args, blending) for piece in pieces]
        light = torch.cat([part[0] for part in parts])
        transmittance = torch.cat([part[1] for part in parts])
    if bool(torch.stack([t.isnan().any() for t in (means, quats, scales, opacities)]).any()):
        light, transmittance = light * torch.nan, transmittance * torch.nan  # nobody can say where it would have been
    light = light.reshape(height, width, -1)
    transmittance = transmittance.reshape(height, width)
    image, depth = (light[..., :-1], light[..., -1]) if depth_channel else (light, None)
    if background is not None:
        image = image + transmittance[..., None] * background.to(dtype)
    return RenderedView(image, depth, transmittance, all_means2d, depths.detach(), radii)
