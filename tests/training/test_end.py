"""How a training ends: with the model before the last iteration's density control, whatever its length."""

from functools import cache

import pytest
from hydra.utils import instantiate
from hypothesis import given, settings
from hypothesis import strategies as st

from tdgbench.training.budget import PlateauRule
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.plateau import Plateau
from tests.helpers.configs import config
from tests.helpers.training import KilledError, digest, ready_to_train

OFTEN = (
    "budget.density.start=20", "budget.density.every=10", "budget.density.opacity_reset_every=60",
    "budget.density.grad_threshold=1e-5", "budget.density.reset_recovery=3", "budget.density.stop=1000",
)  # fmt: skip


LENGTHS = (1, 2, 29, 30, 40, 60, 61, 70, 100)


@pytest.fixture(scope="module")
def saved(small_gray_scene) -> dict[int, str]:
    """Return the model of a training that goes on, before the density control of an iteration, by iteration."""
    trainer, digests = ready_to_train(small_gray_scene, "3dgs", 1000, *OFTEN), {}

    def look(log: TrainingLog) -> None:
        if log.iterations in LENGTHS:
            digests[log.iterations] = digest(trainer)
        if log.iterations == max(LENGTHS):
            raise KilledError

    with pytest.raises(KilledError):
        train(trainer, before_update=look)
    return digests


@pytest.mark.parametrize("length", LENGTHS)
def test_the_last_iteration_changes_nothing(small_gray_scene, saved, length):
    """Like the released code: what is scored is the model before density control, without a last step."""
    trainer = ready_to_train(small_gray_scene, "3dgs", length, *OFTEN)
    log = train(trainer)
    assert log.ended and log.iterations == length == log.lines[-1].iteration
    rules = instantiate(config("budget=demo", *OFTEN).budget.density)
    same_so_far = all(
        rules.is_round(i, length) == rules.is_round(i, 1000) and rules.is_reset(i, length) == rules.is_reset(i, 1000)
        for i in range(1, length)
    )
    assert same_so_far == (length not in (61, 70))
    assert (digest(trainer) == saved[length]) == same_so_far


def test_a_plateau_waits_until_the_models_have_recovered(small_gray_scene):
    """Reached at iteration 64, 4 after a reset; without density control it would end there."""
    late = PlateauRule(epochs=1, patience=1, gain=0.9, after=32)
    ends = {}
    for recovery in (0, 3):
        overrides = (
            *OFTEN,
            f"budget.density.reset_recovery={recovery}",
            f"budget.density.round_recovery={recovery // 3}",
        )
        trainer = ready_to_train(small_gray_scene, "3dgs", 1000, *overrides)
        views = len(small_gray_scene.train)
        trainer.stopping = Plateau(late, views)
        log = train(trainer)
        ends[recovery] = log.iterations
        assert log.ended and log.lines[-1].iteration == log.iterations
    assert ends[0] == 32 + 2 * views
    rules = instantiate(config("budget=demo", *OFTEN).budget.density)
    assert ends[3] == next(i for i in range(ends[0], 1000) if rules.has_recovered(i, 1000))


ANY_LENGTH = st.builds(
    lambda unit, times, beside: max(1, unit * times + beside),
    st.sampled_from([100, 500, 3000]), st.integers(1, 12), st.integers(-120, 120),
)  # fmt: skip


@pytest.mark.parametrize("budget", ["paper", "short", "demo"])
@given(length=ANY_LENGTH)
@settings(max_examples=300)
def test_no_length_is_a_bad_one(budget, length):
    """Around multiples of 100, 500 and 3 000: the model that is scored has recovered from the last density control."""
    rules = _rules(budget)
    assert rules.has_recovered(length, length)
    rounds = [i for i in range(1, length + 1) if rules.is_round(i, length)]
    resets = [i for i in range(1, length + 1) if rules.is_reset(i, length)]
    assert all(length - i >= 100 for i in rounds) and all(length - i >= 500 for i in resets)
    assert all(rules.start < i < rules.stop for i in rounds) and all(i < rules.stop for i in resets)


@pytest.mark.parametrize("length", [7_000, 10_000, 20_000, 30_000])
def test_the_published_lengths_follow_the_released_rules(length):
    """No round or reset of the released code is left out, but for those of the last iteration."""
    rules = _rules("paper")
    released = [i for i in range(501, min(length, 15_000)) if i % 100 == 0]
    assert [i for i in range(1, length + 1) if rules.is_round(i, length)] == released
    resets = [i for i in range(1, min(length, 15_000)) if i % 3000 == 0]
    assert [i for i in range(1, length + 1) if rules.is_reset(i, length)] == resets


@cache
def _rules(budget: str):
    return instantiate(config(f"budget={budget}").budget.density)
