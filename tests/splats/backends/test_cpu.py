import numpy as np
import pytest
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.backends.cpu import MAX_SIDE, pack_camera
from tests.helpers.gaussians import random_gaussians, turned_camera


def test_packed_camera():
    (view,), (K,) = turned_camera(40, 30)
    packed = pack_camera(view, K, 40, 30, 0.2, 100.0, 0.3)
    assert np.allclose(packed[:12].reshape(3, 4), view[:3].numpy())
    assert np.allclose(packed[12:16], [36, 36.8, 22, 12])
    centre = np.append(packed[16:19], 1)
    assert np.allclose(view.numpy() @ centre, [0, 0, 0, 1], atol=1e-6)
    assert np.allclose(packed[19:24], [0.2, 100, 0.3, 40, 30])
    rest = packed[16:19].astype(np.float64) + packed[24:27]
    assert np.abs(view.double().numpy() @ np.append(rest, 1) - [0, 0, 0, 1]).max() < 1e-13


def test_two_renders_before_one_backward():
    """Each render keeps its own lists: two models in one loss (as MSMG) get their own gradients."""
    camera = turned_camera(30, 20)
    first = [p.requires_grad_() for p in random_gaussians(50, 1, None, 1)]
    second = [p.requires_grad_() for p in random_gaussians(70, 2, None, 1)]
    alone = []
    for leaves in (first, second):
        rasterization(*leaves, *camera, 30, 20)[0].square().sum().backward()
        alone.append([p.grad.clone() for p in leaves])
        for p in leaves:
            p.grad = None
    a, b = (rasterization(*leaves, *camera, 30, 20)[0] for leaves in (first, second))
    (a.square().sum() + b.square().sum()).backward()
    for leaves, want in zip((first, second), alone, strict=True):
        assert all(torch.equal(p.grad, w) for p, w in zip(leaves, want, strict=True))


def test_more_pairs_than_expected():
    """Room for the tile lists grows when a few Gaussians cover everything."""
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
