import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from tdgbench.training.budget import RULES
from tdgbench.training.loop import train
from tests.helpers.configs import config
from tests.helpers.paths import ROOT
from tests.helpers.training import ready_to_train


def budget(*overrides):
    return instantiate(config(*overrides).budget)


def test_the_paper_s_settings_are_3dgs_s():
    b = budget("budget=paper", "method=msmg")
    assert (b.iterations, b.sh_degree, b.sh_every) == (30_000, 3, 1000)
    r, d = b.rates, b.density
    assert (r.means_initial, r.means_final, r.means_steps) == (1.6e-4, 1.6e-6, 30_000)
    assert (r.sh_dc, r.sh_rest, r.opacity_logits, r.log_scales, r.quats) == (2.5e-3, 2.5e-3 / 20, 0.05, 5e-3, 1e-3)
    assert (d.start, d.stop, d.every, d.grad_threshold) == (500, 15_000, 100, 2e-4)
    assert (d.clone_max_scale, d.split_into, d.split_into * d.split_shrink) == (0.01, 2, 1.6)
    assert (d.min_opacity, d.max_world_scale, d.max_screen_radius) == (0.005, 0.1, 20)
    assert (d.opacity_reset_every, d.opacity_reset_to) == (3000, 0.01)


def test_tdg_trains_less_and_may_be_overridden():
    assert budget("budget=paper", "method=tdg").iterations == 10_000
    assert budget("budget=paper", "method=tdg", "budget.iterations=20000").iterations == 20_000
    assert budget("budget=short", "method=tdg").iterations == 3000


def test_degrees_rise_on_time():
    b = budget("budget=paper")
    assert [b.active_degree(i) for i in (1, 999, 1000, 2500, 3000, 30_000)] == [0, 0, 1, 2, 3, 3]


def test_schedules_of_methods_do_not_outlast_a_training():
    assert budget("budget=paper", "method=tdg").schedule_length == 10_000
    assert budget("budget=lean").schedule_length == 3000
    assert budget("budget=lean", "budget.iterations=500").schedule_length == 500


def test_the_published_protocol_has_no_rule():
    assert list(RULES) == ["harmonics", "points", "growth", "pixels", "settling", "plateau"]
    assert {name: config("budget=paper").budget[name] for name in RULES} == dict.fromkeys(RULES)


@pytest.mark.parametrize(
    ("option", "value", "phrase"),
    [
        ("points.z", 8, "more than eight standard deviations"), ("points.largest", 64, "squares of 1 to 64 px"),
        ("points.most", 0.7, "kept where more than 70 % would be"),
        ("growth.views", 10, "renders ten training views"), ("growth.z", 4, "more than four standard deviations"),
        ("growth.share", 0.85, "as many as make up 85 %"), ("growth.clearance", 3, "within three standard deviations"),
        ("pixels.largest_scale", 8, "up to 1/8 of their size"), ("pixels.until", 0.4, "after 40 % of the schedule"),
        ("settling.share", 0.1, "A tenth of the training views is held out"),
        ("settling.fewest", 2, "at least two and at most"), ("settling.most", 8, "at least two and at most eight"),
        ("settling.every", 50, "scored every 50 iterations"), ("settling.horizon", 300, "once 300 more would gain"),
        ("settling.gain", 0.15, "less than 0.15 dB by the slope"), ("settling.slope_checks", 12, "at least twelve"),
        ("settling.since", 0.33, "the last two thirds of the iterations"),
        ("settling.most_growth", 0.05, "grow by more than 5 % in 300 iterations"),
        ("settling.growth_checks", 6, "grow by more than 5 % in 300 iterations"),
        ("settling.checks", 3, "three checks that gain less than"),
        ("settling.tail", 0.1, "fall to a tenth within a tenth of the iterations so far"),
        ("settling.slowdown", 0.1, "fall to a tenth within a tenth of the iterations so far"),
        ("iterations", 15_000, "training takes all 15 000 iterations"),
        ("expected_iterations", 3000, "here of 3 000 iterations"), ("sh_every", 1000, "by one every 1 000 iterations"),
        ("rates.log_scales", 1.5 * 5e-3, "1.5 times as fast"), ("rates.quats", 1.5 * 1e-3, "1.5 times as fast"),
        ("rates.sh_rest", 4 * 2.5e-3 / 20, "above degree 0 four times"),
        ("harmonics.every", 500, "rises every 500"), ("harmonics.gain", 0.1, "0.1 dB is the limit of settling"),
        ("background", "mean", "over the mean of the training images"), ("lift_dark_every", 10, "every ten iterations"),
    ],
)  # fmt: skip
def test_the_lean_budget_is_that_of_its_page(option, value, phrase):
    page = " ".join((ROOT / "docs" / "skips.md").read_text(encoding="utf-8").replace("*", "").split())
    assert phrase in page
    assert OmegaConf.select(config("budget=lean").budget, option) == pytest.approx(value)


def test_no_rule_ends_a_trial():
    lean = budget("budget=lean")
    trial = lean.for_trial(70)
    assert trial.iterations == 70 and trial.settling is trial.plateau is None
    assert (trial.growth, trial.pixels, trial.harmonics) == (lean.growth, lean.pixels, lean.harmonics)


@pytest.mark.parametrize(
    ("method", "iterations", "asked", "had"),
    # 13: one round, in which each grows once
    [("tdg", 40, 431, 431), ("mmone", 40, 431, 431), ("msmg", 40, 431, 431), ("3dgs", 13, 9999, 600)],
)
def test_each_set_has_the_number_that_is_given_exactly_where_growth_allows(small_scene, method, iterations, asked, had):
    often = ["budget.density.start=4", "budget.density.every=5", "budget.density.grad_threshold=1000"]
    often += ["method.method.decompose_threshold=0"] * (method == "mmone")  # copies of all that may be copied
    trainer = ready_to_train(small_scene, method, iterations, *often, f"budget.gaussians={asked}")
    train(trainer)
    sets = [report for report in trainer.reports().values() if "gaussians" in report]
    assert [(of["gaussians"], of["gaussians_asked"]) for of in sets] == [(had, asked)] * (2 if method == "msmg" else 1)


@pytest.mark.parametrize("iterations", [2, 3, 7, 3001, 3003])
@pytest.mark.parametrize("share", [0.5, 0.6])
def test_stages_have_the_iterations_of_the_budget(iterations, share):
    whole = budget("budget=short", f"budget.iterations={iterations}")
    stages = whole.for_stage(share), whole.for_stage(1 - share, share)
    assert sum(stage.iterations for stage in stages) == iterations


def test_schedules_of_a_short_stage():
    """Resets are as far apart as a model takes to recover from one; harmonics come sooner, too."""
    of_3dgs = budget("budget=paper", "budget.iterations=2000").for_stage(0.5).density
    assert of_3dgs.opacity_reset_every == of_3dgs.reset_recovery * of_3dgs.every == 500
    assert budget("budget=paper", "budget.iterations=30000").for_stage(0.5).density.opacity_reset_every == 1500
    lean = budget("budget=lean").for_stage(0.5)
    assert (lean.sh_every, lean.harmonics.every) == (500, 250)
