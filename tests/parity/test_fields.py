"""Radiance fields: what nerfstudio, Özer et al. and Roessle et al. compute, by their code."""

import numpy as np
import pytest
import torch

from methods.depth_prior_nerf import depth_loss, depth_moments
from tdgbench.fields import Region, distortion_loss, visible_cells
from tdgbench.fields.networks import truncated_exp
from tdgbench.fields.sampling import DisparitySpacing, interlevel_loss, resampled_edges
from tdgbench.fields.volume import weights_of
from tdgbench.scenes import Camera
from tests.parity.originals import original, relative

UNIT_CUBE = Region((0.0, 0.0, 0.0), 1.0, 0.1, 1.0, is_cube=True)


@pytest.fixture(scope="module")
def data() -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(values) for name, values in original("fields").items()}


def test_positions_are_contracted_into_the_same_cube(data):
    ours, theirs = UNIT_CUBE.contracted(data["contraction_at"]), (data["contraction"] + 2) / 4
    assert relative(ours, theirs) < 1e-6  # of positions at infinity, ours stay below 1


@pytest.mark.parametrize("name", ["nerfacto", "near"])
def test_first_samples_lie_at_the_same_depths(data, name):
    near, far = data[f"spacing_{name}_range"].tolist()
    depths = DisparitySpacing(near, far, 1.0).depths(torch.linspace(0, 1, 25, dtype=torch.float64))
    assert relative(depths, data[f"spacing_{name}"]) < 1e-6


def test_samples_have_the_same_weights(data):
    densities = data["densities"][..., 0].clone().requires_grad_()
    weights = weights_of(densities, data["lengths"][..., 0])
    (weights * data["weights_pull"][..., 0]).sum().backward()
    assert relative(weights.detach(), data["weights"][..., 0]) < 1e-12
    assert relative(densities.grad, data["weights_gradient"][..., 0]) < 1e-12


def test_later_samples_lie_where_proposals_have_weight(data):
    ours = resampled_edges(data["pdf_edges"], data["pdf_weights"][..., 0], 16, None)
    assert relative(ours, data["pdf"]) < 1e-6


def test_distortion_and_proposals_have_the_same_losses(data):
    weights = data["final_weights"][..., 0].clone().requires_grad_()
    loss = distortion_loss(data["pdf"], weights)
    loss.backward()
    assert relative(loss.detach(), data["distortion"]) < 1e-9
    assert relative(weights.grad, data["distortion_gradient"][..., 0]) < 1e-9
    proposed = data["proposal_weights"][..., 0].clone().requires_grad_()
    loss = interlevel_loss(data["pdf"], weights, data["pdf_edges"], proposed)
    loss.backward()
    assert relative(loss.detach(), data["interlevel"]) < 1e-6
    assert relative(proposed.grad, data["interlevel_gradient"][..., 0]) < 1e-6


def test_densities_have_the_same_truncated_gradient(data):
    logarithms = data["exp_at"].clone().requires_grad_()
    densities = truncated_exp(logarithms)
    densities.sum().backward()
    assert torch.allclose(densities, data["exp"], atol=0)
    assert torch.allclose(logarithms.grad, data["exp_gradient"], atol=0)


def test_depth_has_roessles_loss(data):
    """Their last weight is all that passes the others; ours becomes so, with the gradients that come of it."""
    weights = data["depth_weights"].clone()
    weights[:, -1] /= 2
    weights.requires_grad_()
    mean, variance = depth_moments(weights, data["depth_z"])
    prior, spread = data["depth_target"].unbind(dim=1)
    loss = depth_loss(mean, variance + 1e-5, torch.where(data["depth_valid"], prior, 0.0), spread, 1e-3)
    loss.backward()
    assert relative(loss.detach(), data["depth_loss"]) < 1e-9
    expected = data["depth_gradient"] - data["depth_gradient"][:, -1:]
    assert max(relative(*ray) for ray in zip(weights.grad, expected, strict=True)) < 1e-6


def test_the_same_cells_stay_empty(data):
    """Of the cascade that is as large as our box, within our ball; ours begin half a cell before `near`."""
    cells, (fx, fy, width, height) = int(data["grid_cells"]), data["grid_camera"].tolist()
    K = np.array([[fx, 0, width / 2], [0, fy, height / 2], [0, 0, 1]])
    cameras = [Camera(K, pose.numpy(), int(width), int(height)) for pose in data["grid_poses"]]
    nears = (data["grid_near"] + 2 / cells).tolist()
    ball = Region((0.0, 0.0, 0.0), 1.0, 0.1, 1.0)
    visible = visible_cells(cells, ball, data["grid_box"].numpy(), cameras, nears)
    at = torch.arange(cells**3)
    centres = 4 * (torch.stack([at % cells, at // cells % cells, at // cells**2], dim=1) + 0.5) / cells - 2
    inside = centres.norm(dim=1) < 1
    assert torch.equal(visible[inside], ~data["grid_empty"][inside]) and 0.1 < visible[inside].float().mean() < 0.9
