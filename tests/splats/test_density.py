import dataclasses

import pytest
import torch
from hydra.utils import instantiate

from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityControl, DensityRules
from tdgbench.splats.optimizer import Adam
from tests.conftest import config
from tests.splats.test_optimizer import RATES

EXTENT = 10.0


@pytest.fixture(scope="module")
def rules() -> DensityRules:
    return instantiate(config("budget=paper").budget.density)


def five(opacity: float = 0.5) -> Gaussians:
    """0: small; 1: large; 2: huge; 3: faint; 4: small. (extent 10: small ≤ 0.1, huge > 1)"""
    scales = torch.tensor([0.05, 0.5, 2.0, 0.05, 0.05])[:, None].repeat(1, 3)
    opacities = torch.tensor([opacity, opacity, opacity, 0.004, opacity])
    return Gaussians(
        means=torch.arange(15.0).view(5, 3), log_scales=scales.log(),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(5, 1), opacity_logits=opacities.logit(), sh=torch.zeros(5, 1, 1),
    ).as_leaves()  # fmt: skip


def control(rules, hot=(), radii=5):
    """After one view in which the `hot` Gaussians moved by just the threshold (image 100×50)."""
    density = DensityControl(rules, EXTENT, 5)
    grads = torch.zeros(5, 2)
    for index in hot:
        grads[index] = torch.tensor([0.6 * 2e-4 / 50, 0.8 * 2e-4 / 25]) * 1.001
    density.observe(grads, torch.full((5,), radii), 100, 50)
    return density


def update(density, gaussians, iteration):
    optimizer = Adam(gaussians, RATES, EXTENT)
    result, change = density.update(gaussians, optimizer, iteration, torch.Generator().manual_seed(0))
    assert len(optimizer.first) == len(result) == len(density.seen)
    return result, change


def test_clones_small_splits_large_prunes_faint(rules):
    gaussians = five()
    result, change = update(control(rules, hot=(0, 1)), gaussians, 600)
    assert (change.cloned, change.split, change.pruned) == (1, 1, 1)
    assert len(result) == 5 + 1 + 2 - 1 - 1
    assert torch.equal(result.means[:3], gaussians.means[[0, 2, 4]])
    assert torch.equal(result.means[3], gaussians.means[0])
    children = result.select(torch.tensor([4, 5]))
    assert torch.allclose(children.scales, torch.full((2, 3), 0.5 / 1.6))
    offsets = (children.means - gaussians.means[1]).norm(dim=1)
    assert (offsets > 0).all() and (offsets < 5 * 0.5).all()


def test_nothing_below_the_threshold_or_out_of_turn(rules):
    for iteration in (500, 601, 15_000, 20_000):
        assert update(control(rules, hot=(0, 1)), five(), iteration)[1] is None
    result, change = update(control(rules), five(), 600)
    assert (change.cloned, change.split, len(result)) == (0, 0, 4)


def test_gradient_is_a_mean_over_the_views_that_saw_it(rules):
    density = control(rules, hot=(0,))
    density.observe(torch.zeros(5, 2), torch.tensor([5, 5, 5, 5, 5]), 100, 50)
    assert update(density, five(), 600)[1].cloned == 0
    density = control(rules, hot=(0,))
    density.observe(torch.zeros(5, 2), torch.tensor([0, 5, 5, 5, 5]), 100, 50)
    assert update(density, five(), 600)[1].cloned == 1


def test_huge_ones_go_after_the_first_reset(rules):
    assert len(update(control(rules), five(), 2900)[0]) == 4
    assert len(update(control(rules), five(), 3100)[0]) == 3


def test_screen_radius_prunes_only_if_asked_for(rules):
    assert len(update(control(rules, radii=21), five(), 3100)[0]) == 3
    strict = dataclasses.replace(rules, screen_radius_prune=True)
    assert len(update(control(strict, radii=21), five(), 3100)[0]) == 0
    assert len(update(control(strict, radii=20), five(), 3100)[0]) == 3


def test_opacity_reset(rules):
    result, _ = update(control(rules), five(), 3000)
    assert torch.allclose(result.opacities, torch.full((4,), 0.01), atol=1e-6)
    assert result.opacity_logits.requires_grad


def test_cap_keeps_the_hottest(rules):
    density = control(rules, hot=(0, 4))
    density.grad_sum[4] *= 2
    capped = dataclasses.replace(rules, max_gaussians=6)
    density.rules = capped
    result, change = update(density, five(), 600)
    assert change.cloned == 1 and torch.equal(result.means[-1], five().means[4])


def test_everything_may_be_pruned(rules):
    result, change = update(control(rules), five(opacity=0.001), 600)
    assert len(result) == 0 and change.pruned == 5


def test_same_seed_same_children(rules):
    first, second = (update(control(rules, hot=(1,)), five(), 600)[0] for _ in range(2))
    assert torch.equal(first.means, second.means)
