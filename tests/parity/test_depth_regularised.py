"""Depth-regularised Gaussians: alignment, edges and depth losses, in value and gradient, against the authors' code."""

import numpy as np
import pytest
import torch

from methods.aligned_depth import fit
from methods.canny import canny
from methods.depth_regularised import EDGES, depth_smoothness, neighbour_mean, prior_loss
from tests.parity.originals import original, relative

CLOSE = 1e-5
DATA = original("depth_regularised")


def tensor(name):
    return torch.from_numpy(DATA[name])


@pytest.mark.parametrize("name", ["plain", "negative", "many"])
def test_scale_and_shift(name):
    source, target, weights = (DATA[f"{name}_{part}"] for part in ("source", "target", "weights"))
    found = target > 0
    scale, shift = fit(source[found], target[found], weights[found])
    refined = scale * source + shift
    assert (refined < 0).any() == (name == "negative")
    assert relative(refined, DATA[f"{name}_refined"]) < CLOSE


def test_edges():
    assert np.array_equal(~canny((DATA["image"] * 255).astype(np.uint8), *EDGES), DATA["flat"])


def test_smoothness():
    depth = tensor("depth").requires_grad_()
    near = neighbour_mean(depth, (tensor("flat") & (depth > 0)).to(depth))
    loss = depth_smoothness(depth, tensor("flat"))
    loss.backward()
    assert relative(near.detach(), DATA["near"]) < CLOSE
    assert relative(loss.detach(), DATA["smooth"]) < CLOSE and relative(depth.grad, DATA["smooth_grad"]) < CLOSE


def test_depth_loss():
    depth, prior = tensor("depth").requires_grad_(), tensor("prior")
    loss = 0.5 * prior_loss(depth, prior, prior > 0)
    loss.backward()
    assert relative(loss.detach(), DATA["to_prior"]) < CLOSE and relative(depth.grad, DATA["to_prior_grad"]) < CLOSE
