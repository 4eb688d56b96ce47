"""Rays go through their pixels."""

import numpy as np
import torch

from tdgbench.fields.rays import image_rays, rays_of

K = torch.tensor([[50.0, 0, 12], [0, 60, 9], [0, 0, 1]], dtype=torch.float64)


def pose(seed: int) -> torch.Tensor:
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    matrix[:3, 3] = np.random.default_rng(seed).normal(size=3)
    return torch.from_numpy(matrix)


def test_a_point_of_a_ray_is_seen_at_its_pixel_and_depth():
    rays, depths = image_rays(K, pose(0), 24, 18), torch.rand(24 * 18, 3, dtype=torch.float64) + 0.5
    at = rays.at(depths)
    seen = at @ pose(0)[:3, :3].T + pose(0)[:3, 3]
    assert torch.allclose(seen[..., 2], depths)
    image = seen @ K.T
    x, y = (image[..., :2] / image[..., 2:]).unbind(dim=2)
    row, column = torch.arange(18 * 24) // 24, torch.arange(18 * 24) % 24
    assert torch.allclose(x, (column + 0.5)[:, None].expand_as(x).double())
    assert torch.allclose(y, (row + 0.5)[:, None].expand_as(y).double())


def test_every_ray_may_have_its_camera():
    viewmats = torch.stack([pose(1), pose(2), pose(1)])
    pixels = torch.tensor([[3, 4], [5, 6], [7, 8]], dtype=torch.float64)
    together = rays_of(pixels, K.expand(3, 3, 3), viewmats)
    for i in range(3):
        alone = rays_of(pixels[i : i + 1], K, viewmats[i])
        assert torch.allclose(together.origins[i], alone.origins[0])
        assert torch.allclose(together.directions[i], alone.directions[0])
    assert torch.allclose(together.origins[0], torch.linalg.inv(pose(1))[:3, 3])
