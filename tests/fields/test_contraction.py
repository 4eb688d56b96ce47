"""The region of a scene, and its contraction into a box."""

import numpy as np
import pytest
import torch

from tdgbench.fields.contraction import Region, region_of

REGION = Region((1.0, -2.0, 0.5), 3.0, 0.5, 20.0)


def anywhere(count: int = 2000) -> torch.Tensor:
    stream = torch.Generator().manual_seed(0)
    far = 10 ** (6 * torch.rand(count, 1, generator=stream, dtype=torch.float64) - 3)
    return far * torch.randn(count, 3, generator=stream, dtype=torch.float64)


def test_it_is_invertible_and_in_range():
    at = anywhere()
    contracted = REGION.contracted(at)
    assert contracted.min() >= 0 and contracted.max() < 1
    back = REGION.expanded(contracted)
    error = (back - at).norm(dim=1) / (at - at.new_tensor(REGION.center)).norm(dim=1).clamp_min(1)
    assert error.max() < 1e-4


def test_the_ball_keeps_its_shape_and_infinity_is_on_a_sphere():
    inside = anywhere()
    inside = inside[(inside - inside.new_tensor(REGION.center)).norm(dim=1) < REGION.radius]
    expected = 0.5 + (inside - inside.new_tensor(REGION.center)) / (4 * REGION.radius)
    assert len(inside) > 100 and torch.allclose(REGION.contracted(inside), expected)
    far = 1e9 * torch.nn.functional.normalize(anywhere(), dim=1)
    assert torch.allclose((REGION.contracted(far) - 0.5).norm(dim=1), torch.tensor(0.5, dtype=torch.float64), atol=1e-6)


def test_it_is_continuous_with_its_slope_at_the_ball():
    direction = torch.nn.functional.normalize(torch.tensor([[1.0, 2.0, -1.0]], dtype=torch.float64), dim=1)
    radii = torch.tensor([[1 - 1e-6], [1.0], [1 + 1e-6]], dtype=torch.float64) * REGION.radius
    steps = REGION.contracted(direction.new_tensor(REGION.center) + radii * direction).diff(dim=0).norm(dim=1)
    assert torch.allclose(steps[0], steps[1], rtol=1e-4)


def test_a_region_follows_points_and_cameras_and_not_outliers():
    points = np.random.default_rng(0).uniform(-1, 1, (1000, 3))
    camera = np.eye(4)
    camera[2, 3] = 5.0  # points have z of 4 to 6
    region = region_of(points, camera[None])
    assert np.allclose(region.center, 0, atol=0.1) and 0.9 < region.radius < 1.3
    assert 0.7 * 4 < region.near < 0.7 * 4.3 and 1.3 * 5.8 < region.far < 1.3 * 6
    with_outliers = region_of(np.concatenate([points, [[0.0, 0, -4.99], [0, 0, 1e5]]]), camera[None])
    assert np.allclose(region.near, with_outliers.near, rtol=0.02)
    assert np.allclose((*region.center, region.radius), (*with_outliers.center, with_outliers.radius), atol=0.02)


def test_points_behind_all_cameras_are_an_error():
    camera = np.eye(4)
    camera[2, 3] = -5.0
    with pytest.raises(ValueError, match="no point of the scene lies in front"):
        region_of(np.random.default_rng(0).uniform(-1, 1, (10, 3)), camera[None])
