"""The region of a scene, and its contraction into a box."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tdgbench.fields.contraction import Region, region_of

REGION = Region((1.0, -2.0, 0.5), 3.0, 0.5, 20.0)
CUBE = REGION._replace(is_cube=True)


def anywhere(count: int = 2000) -> torch.Tensor:
    stream = torch.Generator().manual_seed(0)
    far = 10 ** (6 * torch.rand(count, 1, generator=stream, dtype=torch.float64) - 3)
    return far * torch.randn(count, 3, generator=stream, dtype=torch.float64)


def length(x: torch.Tensor, region: Region) -> torch.Tensor:
    return x.abs().amax(dim=1) if region is CUBE else x.square().sum(dim=1).sqrt()


@pytest.mark.parametrize("region", [REGION, CUBE])
def test_it_is_invertible_and_in_range(region):
    at = anywhere()
    contracted = region.contracted(at)
    assert contracted.min() >= 0 and contracted.max() < 1
    back = region.expanded(contracted)
    error = (back - at).norm(dim=1) / (at - at.new_tensor(region.center)).norm(dim=1).clamp_min(1)
    assert error.max() < 1e-4


@pytest.mark.parametrize("region", [REGION, CUBE])
def test_the_middle_keeps_its_shape_and_infinity_is_on_a_sphere_or_cube(region):
    inside = anywhere()
    inside = inside[length(inside - inside.new_tensor(region.center), region) < region.radius]
    expected = 0.5 + (inside - inside.new_tensor(region.center)) / (4 * region.radius)
    assert len(inside) > 100 and torch.allclose(region.contracted(inside), expected)
    far = 1e9 * torch.nn.functional.normalize(anywhere(), dim=1)
    at_infinity = length(region.contracted(far) - 0.5, region)
    assert torch.allclose(at_infinity, torch.tensor(0.5, dtype=torch.float64), atol=1e-6)


@pytest.mark.parametrize("region", [REGION, CUBE])
def test_it_is_continuous_with_its_slope_where_contraction_begins(region):
    direction = torch.tensor([[1.0, 2.0, -1.0]], dtype=torch.float64)
    direction = direction / length(direction, region)
    radii = torch.tensor([[1 - 1e-6], [1.0], [1 + 1e-6]], dtype=torch.float64) * region.radius
    steps = region.contracted(direction.new_tensor(region.center) + radii * direction).diff(dim=0).norm(dim=1)
    assert torch.allclose(steps[0], steps[1], rtol=1e-4)


@pytest.mark.parametrize("is_cube", [False, True])
def test_a_region_is_that_of_the_cameras(is_cube):
    """The farthest camera is a unit from their mean: its distance, or its largest coordinate."""
    rng = np.random.default_rng(1)
    centres, poses = rng.uniform(-2, 3, (7, 3)), np.tile(np.eye(4), (7, 1, 1))
    poses[:, :3, :3] = Rotation.random(7, random_state=2).as_matrix()
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], centres)
    region = region_of(rng.uniform(-9, 9, (100, 3)), poses, is_cube)
    away = centres - centres.mean(axis=0)
    largest = np.abs(away).max() if is_cube else np.sqrt(np.square(away).sum(axis=1)).max()
    assert np.allclose(region.center, centres.mean(axis=0)) and region.radius == pytest.approx(largest)
    assert region.is_cube == is_cube


def test_where_cameras_only_turn_a_region_follows_points_and_not_outliers():
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


def test_cameras_and_points_in_one_place_each_are_an_error():
    with pytest.raises(ValueError, match="no unit of length"):
        region_of(np.array([[0.0, 0, 4]] * 3), np.eye(4)[None])


def test_cameras_that_almost_only_turn_are_no_unit():
    """Beyond a thousand units nerfacto sees nothing, and float32 tells few places apart."""
    points = np.array([0, 0, 5]) + np.random.default_rng(0).uniform(-1, 1, (1000, 3))
    for step, is_unit in ((1e-2, True), (1e-3, False)):
        poses = np.tile(np.eye(4), (3, 1, 1))
        poses[:, 0, 3] = [-step, 0, step]
        region = region_of(points, poses)
        assert region.radius == pytest.approx(step) if is_unit else 0.9 < region.radius < 1.3
