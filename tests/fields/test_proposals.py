"""Samples move to where proposals have weight, and proposals learn to bound the field's weights."""

import torch

from tdgbench.fields.adam import FieldAdam
from tdgbench.fields.contraction import Region
from tdgbench.fields.density import DensityField, GridOptions
from tdgbench.fields.proposals import Sampler, annealed, proposal_loss
from tdgbench.fields.rays import Rays

REGION = Region((0.0, 0.0, 0.0), 1.0, 0.5, 4.0)
WALL = 2.3  # z of the surface in front of the cameras


def field(seed: int = 0) -> DensityField:
    return DensityField(GridOptions(4, 8, 64, 12, 16, 0.01), 3, torch.Generator().manual_seed(seed))


def rays(count: int = 256) -> Rays:
    origins = 0.1 * torch.randn(count, 3, generator=torch.Generator().manual_seed(1))
    origins[:, 2] -= 2
    return Rays(origins, torch.tensor([0.0, 0.0, 1.0]).expand(count, 3))


def test_the_start_is_thin_and_the_same_for_equal_seeds():
    densities, features = field()(torch.rand(100, 3))
    assert torch.allclose(densities, torch.tensor(0.01), rtol=0.01) and features.shape == (100, 3)
    assert all(torch.equal(a, b) for a, b in zip(field().parameters(), field().parameters(), strict=True))


def test_samples_lie_on_their_rays():
    sampler = Sampler([field()], (32, 16))
    samples, proposed = sampler(rays(), REGION, torch.Generator().manual_seed(0))
    assert samples.places.shape == (256, 17) and proposed[0][1].shape == (256, 32)
    assert torch.equal(samples.contracted, REGION.contracted(rays().at(samples.depths)).view(-1, 3))
    starts, ends = (samples.depths + sign * samples.lengths * REGION.radius / 2 for sign in (-1, 1))
    assert torch.allclose(starts[:, 1:], ends[:, :-1], atol=1e-5)
    assert starts.min() > REGION.near - 1e-5 and ends.max() < REGION.far * (1 + 1e-5)


def test_a_proposal_learns_the_surface_and_draws_samples_to_it():
    sampler = Sampler([field()], (48, 16))
    optimizer, stream = FieldAdam(sampler.parameters(), 1e-2), torch.Generator().manual_seed(0)
    losses = []
    for _ in range(100):
        samples, proposed = sampler(rays(), REGION, stream, learns=True)
        beyond = ((samples.depths - WALL).abs() <= samples.lengths / 2).float()
        loss = proposal_loss(samples, beyond, proposed)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.3 * losses[0]
    samples, _ = sampler(rays(), REGION)
    near = ((samples.depths - WALL).abs() < 0.3).float().mean()
    assert near > 2 * 0.6 / (REGION.far - REGION.near)


def test_proposals_get_gradients_only_when_they_learn():
    sampler = Sampler([field()], (8, 4))
    for learns in (False, True):
        samples, proposed = sampler(rays(4), REGION, learns=learns)
        assert proposed[0][1].requires_grad == learns and not samples.contracted.requires_grad


def test_annealing_rises_from_0_to_1():
    values = [annealed(i / 10) for i in range(12)]
    assert values == sorted(values) and values[0] == 0 and values[-1] == 1
