"""Geometry of Gaussians and cameras: rotations, projection to the image (EWA), radii, seen colours, camera space."""

from __future__ import annotations

import torch
from torch import Tensor

from tdgbench.splats.harmonics import colors_from_sh
from tdgbench.splats.view import GaussianTensors, Pinhole

TILE = 16  # px


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


def screen_radii(means2d, covariance, width, height) -> Tensor:
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
    radii[seen] = screen_radii(means2d, covariance, camera.width, camera.height)
    return radii


def seen_colors(gaussians: GaussianTensors, index: Tensor | slice, camera: Pinhole) -> Tensor:
    """Return colours (n, D) of the Gaussians at an index (n,), as the camera sees them."""
    if gaussians.sh_degree is None:
        return gaussians.colors[index]
    centre = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3]
    directions = torch.nn.functional.normalize(gaussians.means[index] - centre, dim=-1)
    return colors_from_sh(gaussians.colors[index], directions, gaussians.sh_degree)


def with_pose_gradient(gaussians: GaussianTensors, camera: Pinhole) -> tuple[GaussianTensors, Pinhole]:
    """Return Gaussians and a camera that render the same image, and pass gradients on to a pose that requires them."""
    if not camera.viewmat.requires_grad:
        return gaussians, camera
    viewmat = camera.viewmat.to(gaussians.means)
    return to_camera_space(gaussians, viewmat), camera._replace(viewmat=torch.eye(4, dtype=viewmat.dtype))


def to_camera_space(gaussians: GaussianTensors, viewmat: Tensor) -> GaussianTensors:
    """Transform the Gaussians to the camera space of viewmat (4, 4), with gradients for both.

    Spherical harmonics are evaluated to colours first, as their direction depends on the camera's centre.
    """
    means, quats, _, _, colors, degree = gaussians
    turn, shift = viewmat[:3, :3], viewmat[:3, 3]
    if degree is not None:
        colors = colors_from_sh(colors, torch.nn.functional.normalize(means + turn.T @ shift, dim=1), degree)
    quats = multiply_quaternions(quaternion_of_rotation(turn), quats)
    return gaussians._replace(means=means @ turn.T + shift, quats=quats, colors=colors, sh_degree=None)


def multiply_quaternions(a: Tensor, b: Tensor) -> Tensor:
    """Return the quaternion (..., 4) wxyz of the rotation b followed by a.

    >>> multiply_quaternions(torch.tensor([0.0, 1, 0, 0]), torch.tensor([0.0, 0, 1, 0])).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    (aw, ax, ay, az), (bw, bx, by, bz) = a.unbind(-1), b.unbind(-1)
    parts = [
        aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw,
    ]  # fmt: skip
    return torch.stack(parts, dim=-1)


def quaternion_of_rotation(rotation: Tensor) -> Tensor:
    """Return the quaternion (4,) wxyz of a rotation matrix (3, 3), with a gradient everywhere.

    Each of four formulas divides by one component; the one with the largest component is used.

    >>> quaternion_of_rotation(torch.diag(torch.tensor([1.0, -1.0, -1.0]))).tolist()
    [0.0, 1.0, 0.0, 0.0]
    """
    a, b, c, d, e, f, g, h, i = rotation.flatten()
    candidates = [
        torch.stack([1 + a + e + i, h - f, c - g, d - b]),
        torch.stack([h - f, 1 + a - e - i, b + d, c + g]),
        torch.stack([c - g, b + d, 1 - a + e - i, f + h]),
        torch.stack([d - b, c + g, f + h, 1 - a - e + i]),
    ]
    largest = max(range(4), key=lambda k: float(candidates[k][k].detach()))
    return torch.nn.functional.normalize(candidates[largest], dim=0)
