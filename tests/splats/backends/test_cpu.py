import pytest
import torch

from tdgbench.bench.backend_check.compare import cloud, expected, render
from tdgbench.splats import rasterization
from tdgbench.splats.backends.cpu import MAX_SIDE
from tests.helpers.gaussians import random_gaussians, turned_camera


def test_a_thousand_gaussians_are_exact():
    """In image and gradients, but for few pixels at which a rounding error could flip a threshold of the blend."""
    scene = cloud(1000, 0, 80, 60, channels=3)
    want = expected(scene, "cpu")
    errors = want.errors(render(scene, "cpu", want.weights))
    assert errors.image < 5e-6 and errors.gradients < 1e-5 and want.undecided.double().mean() < 0.02


def test_needles_lose_no_digits():
    """Their determinant, and what the inverse of their covariance does to an axis, are differences of large numbers."""
    scene = cloud(60, 3, 80, 60, channels=3)
    scene.scales[:] = torch.tensor([100, 1e-3, 1e-3])
    want = expected(scene, "cpu")
    errors = want.errors(render(scene, "cpu", want.weights))
    assert errors.image < 1e-3 and errors.gradients < 1e-3


def test_more_pairs_than_expected():
    """The capacity for pairs grows when a few Gaussians cover everything."""
    parameters = random_gaussians(60, 3, None, 1)
    parameters[2][:] = 5.0
    small = [p[:60] for p in parameters]
    image, _, _ = rasterization(*small, *turned_camera(700, 500), 700, 500)
    want, _, _ = rasterization(*[p.double() for p in small], *turned_camera(700, 500), 700, 500, backend="reference")
    assert (image.double() - want).abs().max() < 1e-4


def test_images_too_large_are_refused():
    with pytest.raises(ValueError, match="up to 32767 px a side"):
        rasterization(*random_gaussians(1, 0, None, 1), *turned_camera(8, 8), MAX_SIDE + 1, 1)


def test_no_gradients_where_none_are_asked_for():
    with torch.no_grad():
        image, _, meta = rasterization(*random_gaussians(5, 0, None, 1), *turned_camera(8, 8), 8, 8)
    assert not image.requires_grad and not meta["means2d"][0].requires_grad
