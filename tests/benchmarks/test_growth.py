"""Scores are the benchmark's business; here, what each kind of evidence makes of edges, offsets and noise."""

import dataclasses

import pandas as pd
import pytest
import torch

from benchmarks import growth
from benchmarks.evidence.fragments import fragments
from benchmarks.evidence.rules import CountRule, OpacityRule, ResidualRule
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole
from tdgbench.training.curriculum import Curriculum
from tdgbench.training.growth import GrowthRule
from tdgbench.training.images import THERMAL
from tests.helpers.command import program_here
from tests.helpers.configs import SMALL
from tests.helpers.footprints import drift, edge, two, views

HALVES = GrowthRule(views=10, z=5.0, min_weight=0.0)
RESIDUAL = ResidualRule(views=10, z=5.0, min_weight=0.0)
COUNT = CountRule(views=10, z=3.0, min_weight=0.0, clone_max_scale=100.0)
ONE_MORE = OpacityRule(views=10, z=0.0, min_weight=0.0, target=3, last=2)  # one round in which one Gaussian grows


def offset(x, y, number):
    """The first Gaussian is too dark, in every view."""
    return 0.05 * (x < 0)


def nothing(x, y, number):
    return 0.0 * x


def judge(rule, given, turn=1):
    return rule.significance(rule, given, THERMAL, Curriculum(), "cpu").judge(two(), 0, turn)


def test_fragments_sum_to_the_gradients_of_the_reference():
    view = views(edge)[0]
    camera = Pinhole.of(view.camera).to(two().means)
    gaussians = two().activated(0)
    opacities, colors = gaussians.opacities.clone().requires_grad_(), torch.full((2, 1), 0.5, requires_grad=True)
    given = gaussians._replace(opacities=opacities, means=gaussians.means.clone().requires_grad_())
    render = render_view(given._replace(colors=colors, sh_degree=None), camera, backend="reference")
    gradient = torch.randn(render.image.shape, generator=torch.Generator().manual_seed(0))
    render.image.backward(gradient)
    high = torch.arange(48)[:, None].expand(48, 48) < 24
    seen = fragments(gaussians, camera, render.image.detach(), gradient, high, None)
    assert torch.allclose(seen.opacity, opacities.grad, rtol=1e-4)
    assert torch.allclose(seen.centre, render.projection.means2d.grad, rtol=1e-3, atol=1e-5)
    colors.grad.zero_()
    again = render_view(gaussians._replace(colors=colors, sh_degree=None), camera, backend="reference")
    again.image.sum().backward()
    assert torch.allclose(seen.weight, colors.grad[:, 0], rtol=1e-4)
    assert (seen.centre_parts >= seen.centre.abs()).all() and (seen.opacity_squares > 0).all()


def test_fragments_are_the_pixels_of_the_blend():
    view = views(edge)[0]
    camera = Pinhole.of(view.camera).to(two().means)
    gaussians = two().activated(0)
    left = torch.arange(48)[None, :].expand(48, 48) < 24
    image = torch.zeros(48, 48, 1)
    seen = fragments(gaussians, camera, image, image, left, None)
    for number in range(2):
        only = gaussians._replace(**{k: getattr(gaussians, k)[[number]] for k in gaussians._fields[:5]})
        shown = render_view(only, camera, backend="reference").alpha > 0
        assert seen.count[number] == shown.sum() and seen.high[number] == (shown & left).sum()
    masked = fragments(gaussians, camera, image, image, left, left)
    assert torch.equal(masked.count, seen.high) and (masked.weight[1] < seen.weight[1]).all()


def test_the_whole_footprint_shows_what_a_colour_explains():
    across, whole = views(edge, noise=0.05), views(offset, noise=0.05)
    assert judge(HALVES, across).grow.tolist() == [True, False]
    assert judge(RESIDUAL, across).grow.tolist() == [False, False]
    assert judge(HALVES, whole).grow.tolist() == [False, False]
    assert judge(RESIDUAL, whole).grow.tolist() == [True, False]


def test_a_count_shows_what_differs_between_views():
    differing = views(drift, noise=0.05, count=10)  # five views of each kind, all of them looked at
    assert judge(COUNT, views(edge)).grow.tolist() == [True, False]
    assert judge(HALVES, differing).grow.tolist() == [False, False]
    assert judge(COUNT, differing).grow.tolist() == [True, True]


def test_a_count_needs_pixels_and_gradients():
    for option in ({"pixels": 1000.0}, {"gradient": 1.0}):
        assert not judge(dataclasses.replace(COUNT, **option), views(edge)).grow.any()
    large = dataclasses.replace(COUNT, clone_max_scale=1e-3)
    assert judge(large, views(edge)).grow.tolist() == [True, False]
    assert not judge(dataclasses.replace(large, absolute_gradient=10.0), views(edge)).grow.any()


@pytest.mark.parametrize("rule", [RESIDUAL, COUNT])
def test_noise_does_not_grow(rule):
    assert judge(rule, views(nothing, noise=0.2)).grow.tolist() == [False, False]


def test_noise_grows_without_its_floor():
    assert judge(dataclasses.replace(COUNT, z=0.0), views(nothing, noise=0.2)).grow.tolist() == [True, True]


def test_the_variance_of_the_opacity_gradient_chooses_the_edge():
    verdict = judge(ONE_MORE, views(edge))
    assert verdict.grow.tolist() == [True, False]
    assert verdict.strength[0] > 10 * verdict.strength[1]


def test_as_many_grow_as_the_target_says():
    noisy = views(nothing, noise=0.2)
    assert judge(ONE_MORE, noisy).grow.sum() == 1  # noise, too: the rule knows none
    assert judge(dataclasses.replace(ONE_MORE, target=100), noisy).grow.sum() == 2
    assert judge(dataclasses.replace(ONE_MORE, last=1), noisy).grow.sum() == 0


def test_each_kind_is_trained_and_scored(tmp_path, data_root):
    short = ("budget.iterations=80", "budget.density.start=10", "budget.density.every=20")
    overrides = [*SMALL, *short, f"data.root={data_root}", "method=tdg", "threads=1"]
    run = program_here(growth.main, tmp_path, "growth", *overrides, "--seeds", "0", "--out", str(tmp_path))
    assert run.returncode == 0, run.stderr[-2000:]
    table = pd.read_csv(tmp_path / "growth.csv").set_index("kind")
    assert list(table.index) == list(growth.KINDS) and (table["psnr"] > 5).all() and (table["seconds"] > 0).all()
    assert table["gaussians"].nunique() == len(table)  # each of them grew others
    assert len(run.stdout.splitlines()) == 1 + len(table)


def test_a_cell_that_fails_ends_the_program(tmp_path, data_root):
    run = program_here(
        growth.main, tmp_path, "growth", *SMALL, f"data.root={data_root}", "budget.iterations=0", "--kinds", "halves"
    )
    assert run.returncode == 1 and "budget.iterations" in run.stderr
