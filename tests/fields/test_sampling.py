"""Places of samples against numpy, losses against their double sums."""

import numpy as np
import pytest
import torch

from tdgbench.fields.sampling import (
    HISTOGRAM_PADDING,
    DisparitySpacing,
    SteadySpacing,
    distortion_loss,
    interlevel_loss,
    resampled_edges,
    stratified_edges,
)


def stream(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def intervals(rays: int, count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Edges in [0, 1] and weights whose sum is below 1."""
    edges = torch.rand(rays, count + 1, generator=stream(seed), dtype=torch.float64).sort(dim=1).values
    weights = torch.rand(rays, count, generator=stream(seed + 1), dtype=torch.float64) / count
    return edges, weights


def test_steps_are_even_and_then_in_proportion_to_depth():
    """As a march with dt = max(dt_min, t / n), whose steps are even up to n dt_min."""
    depths = SteadySpacing(near=0.25, far=16.0, unit=2.0).depths(torch.linspace(0, 1, 2001, dtype=torch.float64))
    steps, middles = depths.diff(), (depths[1:] + depths[:-1]) / 2
    assert depths[0] == 0.25 and depths[-1].item() == pytest.approx(16.0)
    expected = middles.clamp_min(2.0)
    assert torch.allclose(steps / steps[0], expected / 2.0, rtol=1e-3)


def test_spacing_is_linear_and_then_even_in_disparity():
    spacing = DisparitySpacing(near=0.25, far=16.0, unit=2.0)
    depths = spacing.depths(torch.linspace(0, 1, 1001, dtype=torch.float64))
    assert depths[0] == 0.25 and torch.isclose(depths[-1], torch.tensor(16.0, dtype=torch.float64))
    near, far = depths[depths < 2].diff(), (1 / depths[depths > 2]).diff()
    assert torch.allclose(near, near[:1]) and torch.allclose(far, far[:1]) and len(near) > 100 and len(far) > 100


def test_stratified_edges_ascend_within_0_to_1_and_are_even_on_average():
    edges = stratified_edges(20_000, 8, stream())
    assert (edges.diff(dim=1) >= 0).all() and edges.min() >= 0 and edges.max() <= 1
    assert edges[:, 0].max() <= 1 / 16 and edges[:, -1].min() >= 15 / 16  # the ends move inwards
    even = torch.linspace(0, 1, 9)
    even[0], even[-1] = 1 / 32, 31 / 32
    assert torch.allclose(edges.mean(dim=0), even, atol=2e-3)
    assert torch.equal(stratified_edges(2, 8, None)[1], torch.linspace(0, 1, 9))
    assert torch.equal(edges, stratified_edges(20_000, 8, stream()))


@pytest.mark.parametrize("shift", [None, 3])
def test_resampled_edges_are_quantiles_as_numpy_has_them(shift):
    edges, weights = intervals(50, 20, 5)
    generator = None if shift is None else stream(shift)
    found = resampled_edges(edges, weights, 12, generator)
    shifts = torch.full((50, 1), 0.5) if shift is None else torch.rand(50, 1, generator=stream(shift))
    for ray in range(50):
        density = weights[ray].numpy() + HISTOGRAM_PADDING
        cdf = np.concatenate([[0], np.cumsum(density / density.sum())])
        quantiles = (np.arange(13) + shifts[ray].item()) / 13
        assert np.allclose(found[ray], np.interp(quantiles, cdf, edges[ray]), atol=1e-6)
    assert (found.diff(dim=1) >= 0).all()


def test_samples_go_where_the_weight_is():
    edges = torch.linspace(0, 1, 11).expand(3, -1)
    weights = torch.zeros(3, 10)
    weights[:, 6] = 0.9
    inside = resampled_edges(edges, weights, 99, stream())
    assert ((inside > 0.6) & (inside < 0.7)).float().mean() > 0.85


def test_weights_of_zero_give_finite_edges_without_gradient():
    edges, weights = torch.linspace(0, 1, 5).expand(2, -1), torch.zeros(2, 4, requires_grad=True)
    found = resampled_edges(edges, weights, 7, None)
    assert torch.isfinite(found).all() and not found.requires_grad


def test_distortion_is_its_double_sum():
    edges, weights = intervals(30, 16, 8)
    weights.requires_grad_()
    centers = (edges[:, 1:] + edges[:, :-1]) / 2
    pairs = weights[:, :, None] * weights[:, None] * (centers[:, :, None] - centers[:, None]).abs()
    exact = (pairs.sum(dim=(1, 2)) + (weights.square() * edges.diff(dim=1)).sum(dim=1) / 3).mean()
    mine = distortion_loss(edges, weights)
    assert torch.isclose(mine, exact)
    assert torch.allclose(*(torch.autograd.grad(loss, weights)[0] for loss in (mine, exact)))


def test_interlevel_loss_is_what_overlapping_intervals_do_not_bound():
    (edges, weights), (proposed, proposed_weights) = intervals(30, 16, 8), intervals(30, 10, 18)
    proposed[:, 0], proposed[:, -1] = 0, 1
    proposed_weights.requires_grad_()
    starts, ends = edges[:, :-1, None], edges[:, 1:, None]
    overlaps = (proposed[:, None, 1:] > starts) & (proposed[:, None, :-1] < ends)
    bound = (overlaps * proposed_weights[:, None]).sum(dim=2)
    exact = ((weights - bound).clamp_min(0).square() / (weights + 1e-7)).mean()
    mine = interlevel_loss(edges, weights, proposed, proposed_weights)
    assert exact > 0 and torch.isclose(mine, exact)
    assert torch.allclose(*(torch.autograd.grad(loss, proposed_weights)[0] for loss in (mine, exact)))


def test_a_proposal_that_equals_the_samples_has_no_loss():
    edges, weights = intervals(30, 16, 8)
    assert interlevel_loss(edges, weights, edges, weights) < 1e-20
    assert not interlevel_loss(edges, weights.requires_grad_(), edges, weights.detach()).requires_grad
