"""SAD-GS: voxels, free points, densities, support and fading against the authors' code."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from methods.sad_gs import SupportControl, at_depth, beside, density
from methods.voxels import voxel_gaussians, voxels
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.harmonics import sh_from_color
from tdgbench.splats.view import Pinhole
from tests.parity.originals import original, relative

CLOSE = 1e-5
DATA = original("sad_gs")


def tensor(name):
    return torch.from_numpy(DATA[name])


def test_voxels():
    found = voxels(DATA["points"], DATA["colors"], 0.23)
    for ours, name in zip(found, ("means", "colors", "covariances"), strict=True):
        assert relative(ours, DATA[f"voxel_{name}"]) < CLOSE, name
    gaussians = voxel_gaussians(DATA["points"], DATA["colors"], 0.23, 1)
    turned = rotation_matrices(gaussians.quats) * gaussians.scales[:, None]
    assert relative(turned @ turned.mT, 4 * DATA["voxel_covariances"]) < CLOSE  # scales are twice the deviations
    assert relative(gaussians.sh[:, 0], sh_from_color(tensor("voxel_colors"))) < CLOSE
    assert bool((gaussians.opacities == 1).all())


@pytest.mark.parametrize(("name", "jitter"), [("free", 0.0), ("free_jittered", 0.01)])
def test_free_points(name, jitter):
    surface = tensor("points")[:40].repeat_interleave(2, dim=0)
    offsets = torch.tensor([-0.05, 0.05], dtype=torch.float64).repeat(40) + jitter
    assert relative(beside(tensor("center"), surface, offsets), DATA[name]) < CLOSE


def test_density():
    names = ("mu", "sigma", "o")
    inputs = mu, sigma, o = [tensor(name).requires_grad_() for name in names]
    points = tensor("q")
    at, of = torch.cartesian_prod(torch.arange(len(points)), torch.arange(len(mu))).T
    roots = torch.linalg.inv(torch.linalg.cholesky(sigma))  # of all square roots, |w| is the same
    whitened = roots[of] @ (points[at] - mu[of])[..., None]
    found = density(whitened.squeeze(2), o[of], at, len(points))
    found.mean().backward()
    assert relative(found.detach(), DATA["density"]) < CLOSE and bool((found == 1).any())
    for given, name in zip(inputs, names, strict=True):
        wanted = DATA[f"{name}_grad"]
        if name == "sigma":  # of a symmetric matrix: how it is shared by the two halves does not matter
            given.grad, wanted = given.grad + given.grad.mT, wanted + wanted.transpose(0, 2, 1)
        assert relative(given.grad, wanted) < CLOSE, name


def test_support_and_fading():
    depth, focal = tensor("depth"), float(DATA["focal"])
    height, width = depth.shape
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64)
    camera = Pinhole(torch.linalg.inv(tensor("camera_to_world")), K, width, height)
    supported = at_depth(tensor("xyz"), camera, depth, 0.15)
    assert np.array_equal(supported, DATA["supported"])

    many = SimpleNamespace(
        means=tensor("xyz"), opacities=tensor("opacity")[:, 0], opacity_logits=tensor("opacity")[:, 0].logit()
    )
    control = SimpleNamespace(
        state=SimpleNamespace(values=None, split=lambda rows: many),
        rules=SimpleNamespace(fade=0.001, supported=lambda means: supported),
    )
    cleared = []
    SupportControl.fade_unsupported(control, SimpleNamespace(flush=lambda: None, reset_moments=cleared.append))
    assert relative(many.opacity_logits, DATA["logits"][:, 0]) < CLOSE and cleared == ["opacity_logits"]
