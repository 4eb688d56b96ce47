import torch

from tests.helpers.gaussians import model


def test_select():
    g = model(1, 1)
    mask = torch.tensor([True, False] * 3 + [True])
    for (_, part), (_, whole) in zip(g.select(mask).items(), g.items(), strict=True):
        assert torch.equal(part, whole[mask])
    assert len(g.select(torch.zeros(7, dtype=torch.bool))) == 0


def test_activated():
    g = model(3, 2)
    means, quats, scales, opacities, colors, degree = g.activated(1)
    assert means is g.means and quats is g.quats and colors is g.sh and degree == 1
    assert torch.equal(scales, g.scales) and torch.equal(opacities, g.opacities)
