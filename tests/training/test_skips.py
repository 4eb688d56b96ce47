import copy

import pytest
from hydra.utils import instantiate

from tdgbench.bench.record_of_run import finished
from tdgbench.training.budget import SKIP_RULES, account
from tdgbench.training.loop import train
from tdgbench.training.skips import SWITCHES, Skip, Skips
from tests.helpers.configs import config
from tests.helpers.training import OFTEN, ready_to_train

NAMES = ["gray", "rgb", "prior", "depth", "unseen", "saturated"]
LEAN = (
    "budget=lean", "budget.iterations=60", "budget.density.start=5", "budget.density.every=5", "budget.density.stop=20",
    "budget.density.grad_threshold=1e-6", "budget.pixels.smallest_side=8", "budget.settling.every=10",
    "budget.settling.checks=1", "budget.settling.slope_checks=2", "budget.settling.full_after=0",
    "budget.settling.since=0", "budget.settling.gain=50",
    "budget.settling.most_growth=50", "budget.settling.fewest=1",
)  # fmt: skip


def test_all_skips_have_names():
    skips = Skips().all()
    assert [s.name for s in skips] == NAMES == list(SWITCHES)
    assert all(s.allowed and not s.taken for s in skips)
    assert [s.name for s in copy.deepcopy(Skips(gray=False)).all() if not s.allowed] == ["gray"]


def test_an_unknown_skip_is_named():
    with pytest.raises(ValueError, match="there is no skip grey; there are gray, rgb"):
        Skips(grey=False)


def test_configurations():
    assert list(config().skip) == ["_target_", *NAMES]
    assert all(skip.allowed for skip in instantiate(config().skip).all())
    assert not any(skip.allowed for skip in instantiate(config("skip=none").skip).all())
    off = [skip.name for skip in instantiate(config("skip.gray=false").skip).all() if not skip.allowed]
    on = [skip.name for skip in instantiate(config("skip=none", "+skip.depth=true").skip).all() if skip.allowed]
    assert (off, on) == (["gray"], ["depth"])


def test_depth_is_left_out_of_iterations():
    skips = Skips()
    assert skips.skip_depth(6, 10) and skips.depth.saved == "depth and its loss in 6 of 10 iterations"
    assert skips.depth.reason == "the depth loss weighs nothing from iteration 5 on"
    assert not skips.skip_depth(0, 10, "it always counts") and skips.depth.reason == "it always counts"


def accounted(trainer, log) -> dict[str, Skip]:
    """The account of a training, by the name of the skip or rule."""
    whole = trainer.whole_context
    return {skip.name: skip for skip in account(whole.budget, whole.skips, finished(trainer, log, whole.scene))}


def after(scene, name="3dgs", **allowed):
    trainer = ready_to_train(scene, name, 30, *OFTEN, skips=Skips(**allowed))
    return accounted(trainer, train(trainer))


def test_reasons_and_savings(small_gray_scene, small_scene):
    gray = after(small_gray_scene)
    assert list(gray) == [*SWITCHES, *SKIP_RULES]
    assert gray["gray"].taken and gray["gray"].saved == "2 of 3 channels"
    assert not after(small_scene)["gray"].taken
    assert gray["unseen"].taken and gray["unseen"].saved.startswith("steps of ")
    assert gray["saturated"].taken == ("blending of" in gray["saturated"].saved)
    assert gray["plateau"].reason.startswith("the loss went on falling, or") and not gray["plateau"].taken
    assert gray["depth"].reason == "the method has no depth loss" and gray["prior"].reason == "the method uses no prior"
    assert all(skip.reason for skip in gray.values())
    tdg = after(small_gray_scene, "tdg")
    assert tdg["depth"].taken and tdg["depth"].saved == "depth and its loss in 16 of 30 iterations"


def test_reasons_are_those_of_the_method(small_gray_scene):
    found = after(small_gray_scene, "depth_regularised")
    assert found["depth"].reason == "its depth loss counts to the end"
    assert after(small_gray_scene, "sad_gs")["depth"].reason == "the method has no depth loss"
    trainer = ready_to_train(small_gray_scene, "thermal3dgs", 30, *LEAN)
    assert accounted(trainer, train(trainer))["pixels"].reason == "the steps of this method need whole images"


def test_a_plateau_is_no_reason_where_another_rule_ended_the_training(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 30, *OFTEN)
    log = train(trainer)
    log.iterations = 20  # as if a rule of the method had ended it there
    found = accounted(trainer, log)["plateau"]
    assert not found.taken and found.reason.startswith("the loss went on falling, or")


def test_what_is_switched_off_says_so(small_gray_scene):
    found = after(small_gray_scene, unseen=False, saturated=False)
    assert found["unseen"].reason == found["saturated"].reason == "switched off" and not found["unseen"].taken


def test_a_backend_that_does_not_count_pairs_is_not_spoken_for(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 5)
    log = train(trainer)
    work = trainer.gaussians["thermal"].work
    work.pairs = work.blended = 0
    saturated = accounted(trainer, log)["saturated"]
    assert saturated.reason == "the backend does not tell" and not saturated.taken


def test_depth_counts_the_iterations_that_were_trained(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "tdg", 30)
    log = train(trainer)
    log.iterations = 10  # as if a rule had ended it there
    depth = accounted(trainer, log)["depth"]
    assert not depth.taken and depth.reason == "training ended after 10 iterations, all of which need depth"


def after_lean(scene, *overrides):
    trainer = ready_to_train(scene, "3dgs", 60, *LEAN, *overrides)
    return accounted(trainer, train(trainer)), trainer


def test_the_rules_of_the_lean_budget(small_gray_scene):
    found, trainer = after_lean(small_gray_scene)
    work = trainer.gaussians["thermal"].work
    assert work.not_grown > 0 and found["growth"].saved.startswith(f"{work.not_grown} times, growth of a")
    assert "evidence from up to 10 views a round" in found["growth"].reason
    assert found["settling"].saved == "27 of 60 iterations"  # it settled at 30; a tenth more, at 1/2 again
    assert found["pixels"].reason == "20 iterations at 1/2"  # the schedule had left it after 17
    assert found["pixels"].saved == f"{20 * 0.75 / 33:.0%} of the pixels"
    assert found["settling"].reason == f"1 held-out view: {trainer.context.curricula['thermal'].reason}"
    assert not found["plateau"].taken and found["plateau"].reason == "the budget has no rule for plateau"


def test_a_training_that_never_settles_has_no_skip(small_gray_scene):
    found, _ = after_lean(
        small_gray_scene, "budget.settling.gain=1e-9", "budget.settling.checks=9", "budget.settling.slope_checks=99"
    )
    said = "1 held-out view: the last iterations are left, and held-out views may still gain"
    assert not found["settling"].taken and found["settling"].reason == said
    found, _ = after_lean(small_gray_scene, "budget.settling.every=100")
    assert found["settling"].reason.endswith("the last iterations are left, and no held-out view was looked at")


def test_settling_comes_before_a_plateau(small_gray_scene):
    rule = "budget.plateau={_target_:tdgbench.training.budget.PlateauRule,epochs:1,patience:1,gain:0.9,after:0}"
    found, _ = after_lean(small_gray_scene, rule)
    assert found["settling"].taken
    assert not found["plateau"].taken and found["plateau"].reason == "the rule for settling decided"


@pytest.mark.parametrize("name", ["growth", "pixels", "settling"])
def test_each_rule_can_be_switched_off_alone(small_gray_scene, name):
    found, trainer = after_lean(small_gray_scene, f"budget.{name}=null")
    assert found[name].reason == f"the budget has no rule for {name}"
    assert not found[name].allowed and not found[name].taken
    assert all(found[other].taken for other in {"growth", "pixels", "settling"} - {name})
    assert (trainer.gaussians["thermal"].decide_growth is None) == (name == "growth")
    assert (trainer.context.curriculum("thermal").resolutions == []) == (name == "pixels")
    assert (trainer.context.curriculum("thermal").held_out == []) == (name == "settling")


def test_points_that_are_left_out_are_counted(small_gray_scene):
    found, trainer = after_lean(small_gray_scene, "budget.points.most=1.0")
    left_out = trainer.gaussians["thermal"].work.points_left_out
    assert found["points"].taken and found["points"].saved == f"{left_out} initial points" and left_out > 0
    found, trainer = after_lean(small_gray_scene, "budget.points=null")
    assert not found["points"].taken and trainer.gaussians["thermal"].work.points_left_out == 0
