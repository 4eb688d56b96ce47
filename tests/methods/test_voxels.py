import numpy as np
import torch

from methods.voxels import FLATTEST, voxel_gaussians


def test_voxels_of_few_points_have_finite_gaussians():
    points = np.array([[0.0, 0, 0], [0.01, 0, 0], [5, 5, 5]])
    for some in (points, points[2:]):
        gaussians = voxel_gaussians(some, np.full((len(some), 1), 0.5), 0.1, 0)
        assert all(torch.isfinite(tensor).all() for _, tensor in gaussians.items())
        assert gaussians.scales.min() >= 0.99 * 2 * FLATTEST * 0.1
