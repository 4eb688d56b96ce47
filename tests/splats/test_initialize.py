import math

import numpy as np
import pytest
import torch

from tdgbench.splats.initialize import gaussians_from_points, neighbour_distances


def test_neighbour_distances_by_brute_force():
    points = np.random.default_rng(0).normal(size=(50, 3))
    squared = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    expected = np.sqrt(np.sort(squared, axis=1)[:, 1:4].mean(axis=1))
    assert np.allclose(neighbour_distances(points), expected)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_points(count):
    distances = neighbour_distances(np.arange(3.0 * count).reshape(count, 3))
    assert np.isfinite(distances).all() and (distances > 0).all()


def test_duplicate_points_get_the_floor():
    assert np.allclose(neighbour_distances(np.zeros((5, 3))), 1e-7**0.5)


@pytest.mark.parametrize("channels", [1, 3])
def test_first_gaussians(channels):
    rng = np.random.default_rng(0)
    colors = rng.random((20, 3)).astype(np.float32)
    g = gaussians_from_points(rng.normal(size=(20, 3)), colors, channels, sh_degree=2)
    assert g.sh.shape == (20, 9, channels) and not g.sh[:, 1:].any()
    expected = colors if channels == 3 else colors.mean(axis=1, keepdims=True)
    assert torch.allclose(0.5 + g.sh[:, 0] / (2 * math.pi**0.5), torch.from_numpy(expected), atol=1e-6)
    assert torch.allclose(g.opacities, torch.full((20,), 0.1))
    assert torch.equal(g.quats, torch.tensor([[1.0, 0, 0, 0]]).expand(20, 4))


def test_bad_clouds_are_refused():
    with pytest.raises(ValueError, match="empty"):
        gaussians_from_points(np.zeros((0, 3)), np.zeros((0, 3)), 3, 0)
    with pytest.raises(ValueError, match="1 points of the cloud are not finite"):
        gaussians_from_points(np.array([[0, 0, np.nan], [1, 1, 1.0]]), np.zeros((2, 3)), 3, 0)
