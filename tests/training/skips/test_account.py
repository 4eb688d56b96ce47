from hydra.utils import instantiate

from tdgbench.training.skips import Skips
from tdgbench.training.skips.account import note_training
from tests.helpers.configs import config
from tests.helpers.training import trained


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
