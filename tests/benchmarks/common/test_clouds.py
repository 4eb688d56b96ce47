import torch

from benchmarks.common.clouds import leaves_of, random_cloud, render, trained_cloud
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.ply import save_ply
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole


def test_a_random_cloud_depends_on_its_seed_and_is_in_front_of_the_camera():
    a, b, c = random_cloud(50, 64, 48), random_cloud(50, 64, 48), random_cloud(50, 64, 48, seed=1)
    assert torch.equal(a.means, b.means) and not torch.equal(a.means, c.means)
    assert a.means[:, 2].min() >= 2 and a.colors.shape == (50, 3)


def test_a_trained_model_from_a_test_view(small_gray_scene, tmp_path):
    points = small_gray_scene.points
    save_ply(gaussians_from_points(points.points, points.colors, 1, 1), tmp_path / "model.ply")
    folder = small_gray_scene.train[0].thermal_path.parents[1]
    cloud = trained_cloud(tmp_path / "model.ply", folder)
    assert cloud.colors.shape == (len(points.points), 3) and (cloud.width, cloud.height) == (48, 36)
    gaussians = GaussianTensors(cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.colors)
    view = render_view(gaussians, Pinhole(cloud.viewmat, cloud.K, 48, 36))
    assert view.transmittance.min() < 0.9  # something is visible


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
