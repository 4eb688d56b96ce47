"""Tiles against a pixel-by-pixel loop in Python that follows 3DGS's text."""

import numpy as np
import pytest
import torch

from tdgbench.splats import geometry, rasterization
from tests.helpers.gaussians import random_gaussians, turned_camera


def blend_by_hand(means2d, conics, opacities, colors, order, width, height):
    image, transmittance = np.zeros((height, width, colors.shape[1])), np.ones((height, width))
    for y in range(height):
        for x in range(width):
            t = 1.0
            for i in order:
                dx, dy = x + 0.5 - means2d[i, 0], y + 0.5 - means2d[i, 1]
                power = -0.5 * (conics[i, 0] * dx * dx + conics[i, 2] * dy * dy) - conics[i, 1] * dx * dy
                alpha = min(0.99, opacities[i] * np.exp(power))
                if alpha < 1 / 255:
                    continue
                if t * (1 - alpha) < 1e-4:
                    break
                image[y, x] += alpha * t * colors[i]
                t *= 1 - alpha
            transmittance[y, x] = t
    return image, transmittance


@pytest.mark.parametrize("backend", ["reference", "cpu"])
@pytest.mark.parametrize("opacity", [0.3, 1.0])
def test_is_the_loop_of_3dgs(backend, opacity):
    parameters, camera = random_gaussians(40, 8, None, 3), turned_camera(21, 18)
    parameters[3][:] = torch.linspace(0.01, opacity, 40)
    doubles = [p.double() for p in parameters]
    means2d, conics, _, z = geometry.project(*doubles[:3], camera[0][0].double(), camera[1][0].double(), 21, 18, 0.3)
    order = [i for i in np.argsort(z.numpy(), kind="stable") if z[i] > 0.2]
    want, t = blend_by_hand(means2d.numpy(), conics.numpy(), doubles[3].numpy(), doubles[4].numpy(), order, 21, 18)
    given = parameters if backend == "cpu" else doubles
    image, alpha, _ = rasterization(*given, *camera, 21, 18, backend=backend)
    assert np.abs(image[0].double().numpy() - want).max() < 1e-5
    assert np.abs(1 - alpha[0, ..., 0].double().numpy() - t).max() < 1e-5


def test_a_saturated_pixel_stops():
    """Behind enough opaque layers nothing is visible, and nothing gets a gradient."""
    count = 50
    means = torch.zeros(count, 3)
    means[:, 2] = torch.linspace(1, 5, count)
    parameters = [means, torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1), torch.full((count, 3), 5.0),
                  torch.full((count,), 0.9), torch.ones(count, 1)]  # fmt: skip
    leaves = [p.requires_grad_() for p in parameters]
    K = torch.tensor([[[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]]])
    image, alpha, _ = rasterization(*leaves, torch.eye(4)[None], K, 16, 16)
    image.sum().backward()
    grads = leaves[4].grad[:, 0]
    assert (grads[:3] > 0).all() and (grads[5:] == 0).all()
    assert alpha.min() > 0.99 and alpha.max() < 1
