import torch

from tdgbench.splats.gaussians import Gaussians, concatenate
from tests.splats.test_ply import model


def test_activations_and_sizes():
    g = model(3, 2)
    assert (len(g), g.channels, g.sh_degree) == (7, 3, 2)
    assert torch.equal(g.scales, g.log_scales.exp()) and torch.equal(g.opacities, g.opacity_logits.sigmoid())
    assert Gaussians.names() == ("means", "log_scales", "quats", "opacity_logits", "sh")


def test_select_and_concatenate():
    g = model(1, 1)
    mask = torch.tensor([True, False] * 3 + [True])
    back = concatenate([g.select(mask), g.select(~mask)])
    assert torch.equal(back.means, torch.cat([g.means[mask], g.means[~mask]]))
    assert len(g.select(torch.zeros(7, dtype=torch.bool))) == 0


def test_leaves():
    leaves = model(1, 0).as_leaves()
    assert all(t.is_leaf and t.requires_grad for _, t in leaves.items())
    assert not any(t.requires_grad for _, t in leaves.detach().items())
    assert not leaves.zeros_like().means.any()
