"""Volume rendering against closed forms."""

import math

import torch

from tdgbench.fields.volume import composited, transmittance_of, weights_of


def constant(density: float, length: float, samples: int = 4000) -> tuple[torch.Tensor, torch.Tensor]:
    """Weights and depths of samples of a constant density along a ray."""
    edges = torch.linspace(0, length, samples + 1, dtype=torch.float64)[None]
    weights = weights_of(torch.full((1, samples), density, dtype=torch.float64), edges.diff(dim=1))
    return weights, (edges[:, 1:] + edges[:, :-1]) / 2


def test_constant_density_absorbs_exponentially():
    density, length = 0.7, 3.0
    weights, depths = constant(density, length)
    left = math.exp(-density * length)
    assert torch.isclose(transmittance_of(weights), torch.tensor([left], dtype=torch.float64))
    mean = 1 / density - left * (length + 1 / density)  # ∫ z σ exp(−σ z) dz
    assert abs(composited(weights, depths[..., None]).item() - mean) < 1e-6


def test_any_channels_over_what_is_behind():
    weights, _ = constant(0.7, 3.0, 40)
    values = torch.rand(1, 40, 5, dtype=torch.float64)
    behind = torch.rand(5, dtype=torch.float64)
    image = composited(weights, values)
    assert image.shape == (1, 5) and torch.allclose(image[0], (weights[0, :, None] * values[0]).sum(dim=0))
    assert torch.allclose(composited(weights, values, behind), image + math.exp(-2.1) * behind)
    same = behind.expand(1, 40, 5)
    assert torch.allclose(composited(weights, same, behind), behind.expand(1, 5))


def test_thin_air_shows_what_is_behind():
    weights, _ = constant(1e-9, 1.0, 10)
    assert transmittance_of(weights).item() > 0.999999


def test_an_opaque_sample_hides_what_follows():
    weights = weights_of(torch.tensor([[0.0, 1e6, 5.0]]), torch.ones(1, 3))
    assert torch.equal(weights, torch.tensor([[0.0, 1.0, 0.0]]))


def test_gradients_are_those_of_finite_differences():
    densities = torch.rand(3, 6, dtype=torch.float64, requires_grad=True)
    lengths = torch.rand(3, 6, dtype=torch.float64)
    values = torch.rand(3, 6, 2, dtype=torch.float64, requires_grad=True)

    def rendered(densities, values):
        weights = weights_of(densities, lengths)
        return composited(weights, values, values[:, -1]), composited(weights, lengths[..., None])

    assert torch.autograd.gradcheck(rendered, (densities, values))
