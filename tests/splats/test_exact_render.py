"""The fast core against the exact render at sizes of thousands of Gaussians, values and gradients.

A rounding error can flip one of the blend's thresholds. Such pixels differ by up to 1/255; they are counted separately
and have no weight in the gradients.
"""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from benchmarks.common.clouds import NAMES, leaves_of, random_cloud, view_of
from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu import pool
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole
from tests.helpers.exact_render import ExactRender, exact_render

FLIP = 2e-5  # share of the range of values; a larger difference is a flipped threshold or an error


def of_core(cloud: Cloud, weights: Tensor) -> ExactRender:
    """Image and gradients of a cloud by the fast core, in float32."""
    leaves = leaves_of(cloud, torch.float32)
    view = view_of(cloud, leaves)
    image = torch.cat([view.image, view.requested_depth[..., None]], dim=-1)
    w = weights.to(image)
    ((image * w[..., :-1]).sum() + (view.transmittance * w[..., -1]).sum()).backward()
    gradients = {name: leaf.grad for name, leaf in zip(NAMES, leaves, strict=True)}
    return ExactRender(image.detach(), view.transmittance.detach(), gradients)


def tensors(result: ExactRender) -> list[Tensor]:
    return [result.image, result.transmittance, *result.gradients.values()]


@pytest.mark.parametrize(("seed", "count", "size"), [(0, 3000, (160, 120)), (1, 3000, (160, 120))])
def test_the_fast_core_is_exact(seed, count, size):
    cloud = random_cloud(count, *size, seed)
    moved = (exact_render(cloud, torch.float64, None, AS_3DGS.moved(factor)).image for factor in (1 - 1e-5, 1 + 1e-5))
    low, high = moved
    undecided = (low - high).abs().amax(dim=-1) > 1e-9
    g = torch.Generator().manual_seed(seed)
    weights = torch.randn(*undecided.shape, 5, generator=g, dtype=torch.float64) * (~undecided)[..., None]
    want = exact_render(cloud, torch.float64, weights)
    results = []
    for threads in (1, 2, 3):
        pool.set_threads(threads)
        results.append(of_core(cloud, weights))
    pool.set_threads(None)
    got = results[0]
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(tensors(got), tensors(other), strict=True))
    of_image = (got.image.double() - want.image).abs() / want.image.amax(dim=(0, 1))
    of_transmittance = (got.transmittance - want.transmittance).abs()[..., None]
    error = torch.cat([of_image, of_transmittance], dim=-1).amax(dim=-1)
    flipped = (error >= FLIP) & undecided
    assert undecided.float().mean() < 0.02 and flipped.float().mean() < 1e-3
    assert error[~flipped].max() < 5e-6
    for name, gradient in want.gradients.items():
        assert (got.gradients[name].double() - gradient).norm() < 1e-5 * gradient.norm(), name


def test_tile_by_tile_is_the_reference():
    cloud = random_cloud(300, 70, 50)
    cloud.means[:10, 2] *= -1  # behind the camera
    weights = torch.randn(50, 70, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    got = exact_render(cloud, torch.float64, weights)
    leaves = leaves_of(cloud, torch.float64)
    camera = Pinhole(cloud.viewmat, cloud.K, 70, 50)
    view = render_view(GaussianTensors(*leaves), camera, depth=True, backend="reference")
    assert torch.allclose(got.image, torch.cat([view.image, view.depth[..., None]], -1).detach(), atol=1e-12)
    loss = (view.image * weights[..., :3]).sum() + (view.depth * weights[..., 3]).sum()
    (loss + (view.transmittance * weights[..., 4]).sum()).backward()
    for leaf, gradient in zip(leaves, got.gradients.values(), strict=True):
        assert torch.allclose(leaf.grad, gradient, rtol=1e-9, atol=1e-12)
