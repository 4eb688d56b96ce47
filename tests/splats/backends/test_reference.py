"""What the reference is checked against: closed forms, and independence of how it is cut into pieces."""

import pytest
import torch

from tdgbench.splats import geometry, rasterization
from tdgbench.splats.backends import cpu, reference
from tdgbench.splats.view import GaussianTensors, Pinhole, RenderOptions
from tests.helpers.gaussians import random_gaussians, turned_camera


def test_rotations_are_rotations():
    r = geometry.rotation_matrices(torch.randn(20, 4, dtype=torch.float64) * 5)
    eye = torch.eye(3, dtype=torch.float64)
    assert torch.allclose(r @ r.transpose(1, 2), eye.expand(20, 3, 3)) and torch.allclose(
        torch.linalg.det(r), r.new_ones(20)
    )
    quarter = geometry.rotation_matrices(torch.tensor([[1.0, 0, 0, 1]]))  # 90° about z
    assert torch.allclose(quarter[0] @ torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0]), atol=1e-6)


@pytest.mark.parametrize("backend", [reference.BACKEND, cpu.BACKEND])
def test_visible_radii_are_those_of_a_render(backend):
    parameters = random_gaussians(400, 3, None, 1)
    parameters[0] *= 3
    gaussians, (viewmat, K) = GaussianTensors(*parameters), (t[0] for t in turned_camera(60, 45))
    camera = Pinhole(viewmat, K, 60, 45)
    radii = geometry.visible_radii(gaussians, camera)
    assert 20 < (radii > 0).sum() < 380
    assert torch.equal(radii, backend.render(gaussians, camera, RenderOptions()).projection.radii)


def test_pieces_do_not_matter(monkeypatch):
    parameters = [p.double() for p in random_gaussians(30, 1, None, 2)]
    whole = rasterization(*parameters, *turned_camera(20, 13), 20, 13, backend="reference")[0]
    monkeypatch.setattr(reference, "PAIRS_AT_ONCE", 100)
    pieces = rasterization(*parameters, *turned_camera(20, 13), 20, 13, backend="reference")[0]
    assert torch.equal(whole, pieces)


def test_two_layers():
    """Two huge opaque-ish sheets: the front one by its opacity, the back one through what is left."""
    quats, scales = torch.tensor([[1.0, 0, 0, 0]]).repeat(2, 1), torch.tensor([[50.0, 50.0, 1e-6]]).repeat(2, 1)
    means, opacities = torch.tensor([[0.0, 0, 2], [0, 0, 5]]), torch.tensor([0.5, 0.8])
    K = torch.tensor([[[10.0, 0, 4], [0, 10.0, 4], [0, 0, 1]]])
    colors = torch.tensor([[1.0], [10.0]])
    image, alpha, _ = rasterization(
        means, quats, scales, opacities, colors, torch.eye(4)[None], K, 8, 8, render_mode="RGB+ED", backend="reference"
    )
    assert image[0, 4, 4].tolist() == pytest.approx([0.5 + 0.5 * 0.8 * 10, (0.5 * 2 + 0.4 * 5) / 0.9], rel=1e-4)
    assert alpha[0, 4, 4, 0].item() == pytest.approx(0.9, rel=1e-4)
