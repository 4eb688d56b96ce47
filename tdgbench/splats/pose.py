"""Gradients of a camera's pose: the Gaussians are moved into camera space by differentiable operations."""

from __future__ import annotations

import torch
from torch import Tensor

from tdgbench.splats.harmonics import colors_from_sh
from tdgbench.splats.view import GaussianTensors, Pinhole


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
