from types import SimpleNamespace

import numpy as np
import pytest

from tdgbench.training.curriculum import Curriculum
from tdgbench.training.loop import stopping_of, train
from tdgbench.training.settling import Settling, SettlingRule
from tdgbench.training.skips import Skips
from tests.helpers.training import digest, ready_to_train

RULE = SettlingRule(share=0.1, fewest=1, every=10, patience=2, gain=0.1, after=20, tail=0.5, slowdown=0.1)
CONF = (
    "+budget.settling={_target_:tdgbench.training.settling.SettlingRule,share:0.1,fewest:1,every:5,patience:1,"
    "gain:50,after:10,tail:0.5,slowdown:0.1}"
)


class Scripted(Settling):
    """Settling whose held-out PSNR follows a script."""

    def __init__(self, psnr, iterations=1000, held=(1,)):
        curriculum = Curriculum()
        curriculum.held, curriculum.is_holding = list(held), bool(held)
        models = {"thermal": SimpleNamespace(optimizer=SimpleNamespace(slowdown=1.0))}
        method = SimpleNamespace(models=lambda: models)
        context = SimpleNamespace(curriculum=curriculum, budget=SimpleNamespace(iterations=iterations))
        super().__init__(RULE, method, context)
        self.psnr, self.asked, self.iteration = psnr, [], 0

    def reached(self, iteration, loss=0.0):
        self.iteration = iteration
        return super().reached(iteration, loss)

    def _held_out_psnr(self):
        self.asked.append(self.iteration)
        return self.psnr(self.iteration)

    @property
    def rate(self):
        return self.method.models()["thermal"].optimizer.slowdown


def end_of(settling, limit=1000):
    return next((i for i in range(1, limit + 1) if settling.reached(i)), None)


def test_it_settles_after_its_patience_and_ends_after_the_tail():
    settling = Scripted(lambda i: min(i, 50) * 1.0)
    assert end_of(settling) == 70 + 35  # best at 50; 60 and 70 are no better; half of 70 on top
    assert settling.asked == [30, 40, 50, 60, 70]
    assert settling.rate == pytest.approx(0.1) and not settling.context.curriculum.is_holding


def test_rates_fall_log_linearly_after_settling():
    settling = Scripted(lambda i: 1.0)
    rates = []
    for i in range(1, 76):
        settling.reached(i)
        rates.append(settling.rate)
    assert rates[:50] == [1.0] * 50 and rates[74] == pytest.approx(0.1) and rates[62] == pytest.approx(0.1 ** (13 / 25))


def test_what_never_settles_has_its_tail_at_the_end():
    settling = Scripted(lambda i: float(i), iterations=300)
    assert end_of(settling, 300) == 300 and settling.asked[-1] == 190
    assert settling.rate == pytest.approx(0.1)


def test_without_held_out_views_only_the_rates_fall():
    settling = Scripted(lambda i: 1.0, iterations=300, held=())
    assert end_of(settling, 300) == 300 and settling.asked == [] and settling.rate == pytest.approx(0.1)


def test_a_restored_state_goes_on_alike():
    settling, again = Scripted(lambda i: 1.0), Scripted(lambda i: 1.0)
    for i in range(1, 60):
        settling.reached(i)
    again.load_state_dict(settling.state_dict())
    assert not again.context.curriculum.is_holding
    assert [settling.reached(i) for i in range(60, 90)] == [again.reached(i) for i in range(60, 90)]
    assert settling.rate == again.rate


def test_held_out_views_are_spread_and_few_views_are_all_trained_on(small_scene):
    views = list(range(40))
    assert RULE.hold_out(views) == [5, 15, 25, 35]  # type: ignore[arg-type]
    assert RULE.hold_out(views[:3]) == []  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["splat", "tdg", "msmg"])
def test_methods_stop_by_it(small_gray_scene, name):
    method, context = ready_to_train(small_gray_scene, name, 60, CONF, "budget.density.stop=10")
    stopping = stopping_of(method, context)
    assert isinstance(stopping, Settling) and len(context.curriculum.held) == 1
    log = train(method, 60, plateau=stopping)
    assert log.iterations == 30 and log.ended  # checks at 15 and 20; the tail has 10
    assert all(np.isclose(model.optimizer.slowdown, 0.1) for model in method.models().values())


def test_switched_off_the_training_is_that_without_the_rule(small_gray_scene):
    digests = []
    for overrides in ((), (CONF,)):
        method, context = ready_to_train(
            small_gray_scene, "splat", 30, *overrides, skips=Skips(settling=False, plateau=False)
        )
        assert stopping_of(method, context) is None
        train(method, 30)
        digests.append(digest(method))
    assert digests[0] == digests[1]
