import torch

from tdgbench.experiments.measure.clouds import random_cloud
from tdgbench.experiments.measure.oracle import leaves_of, render
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole


def test_tile_by_tile_is_the_reference():
    cloud = random_cloud(300, 70, 50)
    cloud.means[:10, 2] *= -1  # behind the camera
    weights = torch.randn(50, 70, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    got = render(cloud, torch.float64, weights)
    leaves = leaves_of(cloud, torch.float64)
    camera = Pinhole(cloud.viewmat, cloud.K, 70, 50)
    view = render_view(GaussianTensors(*leaves), camera, depth=True, backend="reference")
    assert torch.allclose(got.image, torch.cat([view.image, view.depth[..., None]], -1).detach(), atol=1e-12)
    loss = (view.image * weights[..., :3]).sum() + (view.depth * weights[..., 3]).sum()
    (loss + (view.transmittance * weights[..., 4]).sum()).backward()
    for leaf, gradient in zip(leaves, got.gradients.values(), strict=True):
        assert torch.allclose(leaf.grad, gradient, rtol=1e-9, atol=1e-12)
