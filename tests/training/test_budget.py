import pytest
from hydra.utils import instantiate

from tdgbench.training.budget import RULES
from tdgbench.training.loop import train
from tests.helpers.configs import config
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
