from hydra.utils import instantiate

from tdgbench.training.loop import stopping_of, train
from tdgbench.training.skips import Skips
from tdgbench.training.skips.account import note_training
from tests.helpers.configs import config
from tests.helpers.training import ready_to_train, trained


def account(scene, name="splat", **options):
    skips = Skips(**options)
    method, log = trained(scene, name, 30, skips=skips)
    budget = instantiate(config("budget=demo", "budget.iterations=30", "budget.sh_every=25").budget)
    note_training(skips, scene, method, budget, log)
    return {skip.name: skip for skip in skips.all()}


def test_reasons_and_savings(small_gray_scene, small_scene):
    gray = account(small_gray_scene)
    assert gray["gray"].taken and gray["gray"].saved == "2 of 3 channels"
    assert not account(small_scene)["gray"].taken
    assert gray["unseen"].taken and "% of the rows" in gray["unseen"].saved
    assert gray["plateau"].reason == "the loss went on falling" and not gray["plateau"].taken
    assert all(skip.reason for skip in gray.values())


def test_what_is_switched_off_says_so(small_gray_scene):
    found = account(small_gray_scene, unseen=False, saturated=False)
    assert found["unseen"].reason == found["saturated"].reason == "switched off" and not found["unseen"].taken


def test_methods_without_depth_or_prior(small_gray_scene):
    found = account(small_gray_scene)
    assert found["depth"].reason == "splat has no depth loss" and found["prior"].reason == "splat uses no prior"
    tdg = account(small_gray_scene, "tdg")
    assert tdg["depth"].taken and tdg["depth"].saved == "depth and its loss in 16 of 30 iterations"


def test_a_backend_that_does_not_count_pairs_is_not_spoken_for(small_gray_scene):
    skips = Skips()
    method, log = trained(small_gray_scene, "splat", 5, skips=skips)
    work = method.models()["thermal"].work
    work.pairs = work.blended = 0
    note_training(skips, small_gray_scene, method, instantiate(config("budget=demo").budget), log)
    assert skips.saturated.reason == "the backend does not tell" and not skips.saturated.taken


RULES = (
    "budget=lean", "budget.iterations=60", "budget.density.start=5", "budget.density.every=5", "budget.density.stop=20",
    "budget.density.grad_threshold=1e-6", "budget.pixels.smallest_side=8", "budget.settling.every=10",
    "budget.settling.checks=1", "budget.settling.gain=50", "budget.settling.fewest=1",
)  # fmt: skip


def account_lean(scene, *overrides, **options):
    skips = Skips(**options)
    method, context = ready_to_train(scene, "splat", 60, *RULES, *overrides, skips=skips)
    log = train(method, 60, stopping=stopping_of(method, context))
    note_training(skips, scene, method, context.budget, log)
    return {skip.name: skip for skip in skips.all()}, method


def test_the_rules_of_the_lean_budget(small_gray_scene):
    found, method = account_lean(small_gray_scene)
    work = method.models()["thermal"].work
    assert work.withheld > 0 and found["growth"].saved == f"growth of {work.withheld} Gaussians with large gradients"
    assert "evidence from 10 views a round" in found["growth"].reason
    assert found["settling"].saved == "22 of 60 iterations"  # it settled at 30; a quarter more, at 1/2 again
    assert found["pixels"].reason == "25 iterations at 1/2"  # the schedule had left it after 17
    assert found["pixels"].saved == f"{25 * 0.75 / 38:.0%} of the pixels"
    assert found["settling"].reason == "1 held-out views gained less than 50 dB from window to window"
    assert not found["plateau"].taken and found["plateau"].reason == "the budget has no plateau rule"


def test_a_training_that_never_settles_has_no_skip(small_gray_scene):
    found, _ = account_lean(small_gray_scene, "budget.settling.gain=1e-9", "budget.settling.checks=9")
    assert not found["settling"].taken and "went on getting better" in found["settling"].reason


def test_settling_comes_before_a_plateau(small_gray_scene):
    rule = "+budget.plateau={_target_:tdgbench.training.skips.plateau.PlateauRule,rounds:1,patience:1,gain:0.9,after:0}"
    found, _ = account_lean(small_gray_scene, rule)
    assert found["settling"].taken
    assert not found["plateau"].taken and found["plateau"].reason == "the skip `settling` decided"


def test_depth_counts_the_iterations_that_were_trained(small_gray_scene):
    skips = Skips()
    method, _ = ready_to_train(small_gray_scene, "tdg", 30, skips=skips)
    log = train(method, 10)
    note_training(skips, small_gray_scene, method, instantiate(config("budget=demo").budget), log)
    assert not skips.depth.taken and skips.depth.reason == "training ended after 10 iterations, all of which need depth"


def test_each_rule_can_be_switched_off_alone(small_gray_scene):
    everything = {"growth", "pixels", "settling"}
    for name in everything:
        found, method = account_lean(small_gray_scene, **{name: False})
        assert found[name].reason == "switched off" and not found[name].taken
        assert all(found[other].taken for other in everything - {name})
        model = method.models()["thermal"]
        assert (model.significance is None) == (name == "growth")
        assert (model.curriculum.steps == []) == (name == "pixels")
        assert (model.curriculum.held == []) == (name == "settling")


def test_budgets_without_the_rules_take_none_of_them(small_gray_scene):
    found = account(small_gray_scene)
    for name in ("growth", "pixels", "settling"):
        assert found[name].reason.startswith("the budget has no") and not found[name].taken
