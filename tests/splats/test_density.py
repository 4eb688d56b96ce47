import dataclasses

import pytest
import torch
from hydra.utils import instantiate

from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityControl, DensityRules, GrowthDecision
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tests.helpers.configs import config
from tests.helpers.gaussians import RATES

EXTENT = 10.0


@pytest.fixture(scope="module")
def rules() -> DensityRules:
    return instantiate(config("budget=paper").budget.density)


def five(opacity: float = 0.5, dtype=torch.float32) -> TrainingState:
    """0: small; 1: large; 2: huge; 3: faint; 4: small. (extent 10: small ≤ 0.1, huge > 1) Along a line."""
    scales = torch.tensor([0.05, 0.5, 2.0, 0.05, 0.05])[:, None].repeat(1, 3)
    opacities = torch.tensor([opacity, opacity, opacity, 0.004, opacity])
    given = Gaussians(
        means=torch.arange(15.0).view(5, 3), log_scales=scales.log(),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(5, 1), opacity_logits=opacities.logit(), sh=torch.zeros(5, 1, 1),
    )  # fmt: skip
    return TrainingState(given.map(lambda t: t.to(dtype)))


def look(density: DensityControl, hot=(), radii=5) -> None:
    """One view in which the `hot` Gaussians moved by just the threshold (image 100×50)."""
    like = density.state.values
    grads = like.new_zeros(5, 2)
    for index in hot:
        grads[index] = torch.tensor([0.6 * 2e-4 / 50, 0.8 * 2e-4 / 25]) * 1.001
    radii = torch.full((5,), radii, dtype=torch.int32) if isinstance(radii, int) else torch.tensor(radii).int()
    gradients = Gradients.dense(like.new_zeros(5, 16), grads, radii)
    density.observe_visible(gradients)
    density.observe_gradients(gradients, 100, 50)


def control(rules, hot=(), radii=5, state=None) -> DensityControl:
    density = DensityControl(rules, EXTENT, state or five(), iterations=30_000)
    look(density, hot, radii)
    return density


def update(density, iteration):
    state = density.state
    optimizer = Adam(state, RATES, EXTENT)
    change = density.update(optimizer, iteration, torch.Generator().manual_seed(0))
    assert len(state) == len(density.view_counts)
    return state.split(state.values), change


def rows_of(gaussians, means) -> list[int]:
    return [int((gaussians.means == mean).all(dim=1).sum()) for mean in means]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_clones_small_splits_large_prunes_faint(rules, dtype):
    state = five(dtype=dtype)
    before = state.split(state.values.clone())
    result, change = update(control(rules, hot=(0, 1), state=state), 600)
    assert (change.densified, change.cloned, change.split, change.pruned) == (True, 1, 1, 1)
    assert len(result) == 5 + 1 + 2 - 1 - 1
    assert rows_of(result, before.means) == [2, 0, 1, 0, 1]
    children = result.select(torch.tensor([rows_of(before, [mean]) == [0] for mean in result.means]))
    assert len(children) == 2 and torch.allclose(children.scales, torch.full((2, 3), 0.5 / 1.6).to(dtype))
    offsets = (children.means - before.means[1]).norm(dim=1)
    assert (offsets > 0).all() and (offsets < 5 * 0.5).all()


def test_nothing_below_the_threshold_or_out_of_turn(rules):
    for iteration in (500, 601, 15_000, 20_000):
        result, change = update(control(rules, hot=(0, 1)), iteration)
        assert not change.densified and len(result) == 5
    result, change = update(control(rules), 600)
    assert (change.cloned, change.split, len(result)) == (0, 0, 4)


def test_gradient_is_a_mean_over_the_views_that_saw_it(rules):
    density = control(rules, hot=(0,))
    look(density)
    assert update(density, 600)[1].cloned == 0
    density = control(rules, hot=(0,))
    look(density, radii=[0, 5, 5, 5, 5])
    assert update(density, 600)[1].cloned == 1


def test_huge_ones_go_after_the_first_reset(rules):
    assert len(update(control(rules), 2900)[0]) == 4
    assert len(update(control(rules), 3100)[0]) == 3


def test_screen_radius_prunes_only_if_asked_for(rules):
    assert len(update(control(rules, radii=21), 3100)[0]) == 3
    strict = dataclasses.replace(rules, screen_radius_prune=True)
    assert len(update(control(strict, radii=21), 3100)[0]) == 0
    assert len(update(control(strict, radii=20), 3100)[0]) == 3


def test_opacity_reset(rules):
    result, change = update(control(rules), 3000)
    assert change.opacity_reset and torch.allclose(result.opacities, torch.full((4,), 0.01), atol=1e-6)


def test_cap_keeps_the_hottest(rules):
    density = control(dataclasses.replace(rules, max_gaussians=6), hot=(0, 4))
    density.grad_sum[4] *= 2
    last = density.state.values[4, :3].clone()
    result, change = update(density, 600)
    assert change.cloned == 1 and rows_of(result, [last]) == [2]


def test_splits_into_many_stay_below_the_cap(rules):
    density = control(dataclasses.replace(rules, max_gaussians=6, split_into=3), hot=(1, 2))
    result, change = update(density, 600)
    assert (change.cloned, change.split) == (0, 0) and len(result.means) == 4  # a split would add two to five


def test_what_holds_a_camera_does_not_grow(rules):
    density = control(rules)
    optimizer, generator = Adam(density.state, RATES, EXTENT), torch.Generator().manual_seed(0)
    at_camera = torch.tensor([True, False, False, False, False])
    density.update(optimizer, 600, generator, GrowthDecision(torch.ones(5), at_camera, at_camera))
    assert sorted(density.state.values[:, 0].tolist()) == [3, 6, 12]


def test_what_holds_a_camera_is_pruned_at_once(rules):
    density = control(rules)
    none = torch.zeros(5)
    optimizer, generator = Adam(density.state, RATES, EXTENT), torch.Generator().manual_seed(0)
    at_camera = torch.tensor([True, False, False, True, False])  # the fourth is transparent, too
    density.update(optimizer, 600, generator, GrowthDecision(none, none > 0, at_camera))
    assert sorted(density.state.values[:, 0].tolist()) == [3, 6, 12]


def test_everything_may_be_pruned(rules):
    result, change = update(control(rules, state=five(opacity=0.001)), 600)
    assert len(result) == 0 and change.pruned == 5


def test_same_seed_same_children(rules):
    first, second = (update(control(rules, hot=(1,)), 600)[0] for _ in range(2))
    assert torch.equal(first.means, second.means)


def look_twice(density: DensityControl, signed: dict[int, float], absolute: dict[int, float]) -> None:
    """One view of 100×50 px; numbers are lengths of gradients in units of half the image."""
    like = density.state.values
    grads = like.new_zeros(2, 5, 2)
    for which, lengths in enumerate((signed, absolute)):
        for index, length in lengths.items():
            grads[which, index] = torch.tensor([0.6 * length / 50, 0.8 * length / 25])
    gradients = Gradients.dense(like.new_zeros(5, 16), grads[0], torch.full((5,), 5).int(), grads[1])
    density.observe_visible(gradients)
    density.observe_gradients(gradients, 100, 50)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    ("changes", "grown"),
    [  # clones, splits: 0, 4 are small; 1, 2 are large
        ({}, (1, 2)),
        ({"gradient": "absolute", "grad_threshold": 7e-4}, (1, 1)),
    ],
)
def test_which_gradient_clones_and_splits(rules, dtype, changes, grown):
    density = DensityControl(dataclasses.replace(rules, **changes), EXTENT, five(dtype=dtype), 30_000)
    look_twice(density, {0: 2.1e-4, 1: 2.1e-4, 2: 3e-4, 4: 1e-4}, {0: 2.5e-4, 1: 8e-4, 2: 3.5e-4, 4: 8e-4})
    saved = density.state_dict()
    again = DensityControl(density.rules, EXTENT, five(dtype=dtype), 30_000)
    again.load_state_dict(saved)
    for one in (density, again):
        change = update(one, 600)[1]
        assert (change.cloned, change.split) == grown
    assert ("absolute_sum" in saved) == density.rules.uses_absolute


def test_a_method_may_state_its_authors_choice(rules):
    assert (rules.gradient, rules.grad_threshold) == ("signed", 2e-4)
    theirs = instantiate(config("+method.gradient=absolute", "+method.grad_threshold=7e-4").budget.density)
    assert (theirs.gradient, theirs.grad_threshold) == ("absolute", 7e-4)


def test_gradients_without_absolute_ones_are_refused(rules):
    density = DensityControl(dataclasses.replace(rules, gradient="absolute"), EXTENT, five(), 30_000)
    with pytest.raises(ValueError, match="render the view with absgrad=True"):
        look(density)
