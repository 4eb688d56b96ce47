"""Rays of a camera's pixels."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Rays(NamedTuple):
    """Rays whose directions have z = 1 in their camera, so that the place along a ray is a depth."""

    origins: Tensor  # (R, 3) world
    directions: Tensor  # (R, 3) world

    def at(self, depths: Tensor) -> Tensor:
        """Return the positions (R, S, 3) at depths (R, S)."""
        return torch.addcmul(self.origins[:, None], self.directions[:, None], depths[..., None])


def rays_of(pixels: Tensor, K: Tensor, viewmat: Tensor) -> Rays:
    """Return the rays through the centres of pixels (R, 2) whole x and y.

    K (3, 3) or (R, 3, 3) px, viewmat (4, 4) or (R, 4, 4) world to camera: of OpenCV pinhole cameras without skew.
    """
    x = (pixels[:, 0] + 0.5 - K[..., 0, 2]) / K[..., 0, 0]
    y = (pixels[:, 1] + 0.5 - K[..., 1, 2]) / K[..., 1, 1]
    turn, shift = viewmat[..., :3, :3].expand(len(pixels), 3, 3), viewmat[..., :3, 3].expand(len(pixels), 3)
    directions = torch.einsum("ri,rij->rj", torch.stack([x, y, torch.ones_like(x)], dim=1), turn)
    return Rays(-torch.einsum("ri,rij->rj", shift, turn), directions)


def image_rays(K: Tensor, viewmat: Tensor, width: int, height: int) -> Rays:
    """Return the rays of all pixels, row by row."""
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return rays_of(torch.stack([columns, rows], dim=2).reshape(-1, 2).to(K), K, viewmat)
