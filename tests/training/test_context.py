"""What a method is set up with, and the parts that it makes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from tdgbench.bench.init.points import CubeAroundCameras
from tdgbench.training.context import Context, ViewOrder
from tdgbench.training.curriculum import Curriculum
from tdgbench.training.part import Part
from tests.helpers.configs import config


def context_of(scene, *overrides: str, seed: int = 0) -> Context:
    budget = instantiate(config("budget=demo", *overrides).budget)
    return Context(scene, scene.points, {}, budget, "cpu", seed)


def test_views_come_once_per_round():
    order = ViewOrder(list(range(7)), 0, Curriculum())  # type: ignore[arg-type]
    rounds = [[order.next() for _ in range(7)] for _ in range(3)]
    assert all(sorted(r) == list(range(7)) for r in rounds)
    assert rounds[0] != rounds[1]
    assert [order.left for _ in range(7) if order.next() is not None] == [6, 5, 4, 3, 2, 1, 0]


def test_streams_are_independent_and_repeatable(small_scene):
    def draws(seed):
        context = context_of(small_scene, seed=seed)
        return [torch.rand(4, generator=context.random(name)).numpy() for name in "abc"]

    first, again, other = draws(0), draws(0), draws(1)
    assert np.array_equal(first, again)
    assert len({a.tobytes() for a in (*first, *other)}) == 6


def test_stages_have_streams_of_their_own(small_scene):
    whole = context_of(small_scene)
    draws = [torch.rand(4, generator=whole.for_stage(number, 0.5).random("a")) for number in (0, 1, 0)]
    assert not torch.equal(draws[0], draws[1]) and torch.equal(draws[0], draws[2])


def test_parts_are_kept_by_name(small_scene):
    context = context_of(small_scene).for_stage(0, 1.0)
    made = [context.gaussians("rgb"), context.gaussians(name="second"), context.views("order"), context.random("noise")]
    network = context.network("mlp", torch.nn.Linear(2, 1), 1e-3)
    assert list(context.parts) == ["curriculum", "rgb", "second", "order", "noise", "mlp"]
    assert context.parts["rgb"] is made[0] and context.parts["mlp"] is network
    assert context.parts["noise"].generator is made[3]  # type: ignore[attr-defined]


def test_two_parts_of_one_name_are_an_error(small_scene):
    context = context_of(small_scene)
    context.gaussians()
    with pytest.raises(ValueError, match="two parts have the name 'thermal'; give one of them another name"):
        context.add_part("thermal", Part())


def test_gaussians_are_those_of_their_modality(small_gray_scene):
    context = context_of(small_gray_scene, "budget.background=mean")
    thermal, rgb = context.gaussians(), context.gaussians("rgb")
    assert (thermal.state.channels, rgb.state.channels) == (1, 3)
    assert thermal.background.numpy() == pytest.approx(
        np.mean([view.thermal for view in small_gray_scene.train]), abs=1e-5
    )
    assert rgb.background.numpy() == pytest.approx(
        np.mean([view.rgb for view in small_gray_scene.train], axis=(0, 1, 2)), abs=1e-5
    )
    assert torch.equal(thermal.gaussians.means, rgb.gaussians.means)


def test_gaussians_have_further_fields_with_rates(small_gray_scene):
    context = context_of(small_gray_scene)
    emissivity = torch.zeros(len(small_gray_scene.points.points), 2)
    model = context.gaussians(
        extra_fields={"emissivity": emissivity}, learning_rates={"emissivity": 0.01, "means": 0.0}
    )
    before = model.copy()

    def brighter(gaussians, degree):
        shown = gaussians.activated(degree)
        return shown._replace(
            colors=shown.colors * (1 + gaussians.extra_fields["emissivity"].sum(dim=1))[:, None, None]
        )

    for iteration in (1, 2):
        model.begin(iteration)
        model.render(small_gray_scene.train[0].camera, hook=brighter).image.mean().backward()
        assert model.step(iteration) is None
    after = model.gaussians
    assert torch.equal(after.means, before.means)  # frozen
    assert (after.extra_fields["emissivity"] < 0).any() and after.extra_fields["emissivity"].shape == emissivity.shape


def test_a_budget_is_shared_out_among_stages(small_scene):
    budget = replace(context_of(small_scene).budget, expected_iterations=600)
    whole = Context(small_scene, small_scene.points, {}, budget, "cpu", 0)
    stage = whole.for_stage(1, 0.25).budget
    assert (stage.iterations, stage.expected_iterations) == (300, 150)
    assert (stage.rates.means_steps, stage.sh_every, stage.plateau.after) == (300, 125, 175)  # of 1 200, 500, 700
    density = stage.density
    assert (density.start, density.stop, density.every, density.opacity_reset_every) == (50, 175, 100, 2500)
    full = replace(budget, iterations=60_000, rates=replace(budget.rates, means_steps=30_000)).for_stage(0.5)
    assert full.iterations == 30_000 and (full.rates.means_steps, full.density) == (30_000, budget.density)
    assert whole.for_stage(0, 1.0).budget == budget and whole.for_stage(0, 1e-9).budget.iterations == 1


POINT_RULE = ("budget=demo", "+budget.points={_target_:tdgbench.training.budget.PointRule,z:8,largest:16,most:1.0}")


def test_models_begin_with_the_points_that_are_kept(small_scene):
    context = context_of(small_scene, *POINT_RULE)
    total = len(small_scene.points.points)
    thermal, rgb = context.gaussians(), context.gaussians("rgb")
    assert 10 < len(thermal) < total and len(thermal) == context.kept_points("thermal").sum()
    assert len(rgb) == total
    assert thermal.work.points_left_out == total - len(thermal)
    assert len(context_of(small_scene).gaussians()) == total  # `demo` has no such rule


def test_random_points_and_those_with_further_fields_are_all_kept(small_scene):
    context = context_of(small_scene, *POINT_RULE)
    total = len(small_scene.points.points)
    with_field = context.gaussians(
        extra_fields={"more": torch.zeros(total, 1)}, learning_rates={"more": 0.1}, name="second"
    )
    assert len(with_field) == total and with_field.work.points_left_out == 0
    random = CubeAroundCameras(total, 3.0, seed=0).points(small_scene)
    for other in (replace(context, points=random), replace(context, keeps_all_points=True)):
        assert len(other.gaussians()) == total
