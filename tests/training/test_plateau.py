from tdgbench.training.budget import PlateauRule
from tdgbench.training.plateau import Plateau


def stops_at(losses, **rule):
    watch = Plateau(PlateauRule(**{"rounds": 1, "patience": 2, "gain": 0.01, "after": 0, **rule}), views=5)
    return next((i for i, loss in enumerate(losses, start=1) if watch.reached(i, loss)), None)


def test_a_falling_loss_goes_on():
    assert stops_at([0.99**i for i in range(200)]) is None


def test_a_flat_loss_stops_after_its_patience():
    assert stops_at([1.0] * 100) == 15  # one window to compare with, two that are no better
    assert stops_at([1.0] * 100, patience=3) == 20
    assert stops_at([1.0] * 100, after=30) == 45
    assert stops_at([1.0] * 100, rounds=2) == 30


def test_one_better_window_starts_the_patience_anew():
    assert stops_at([1.0] * 10 + [0.5] * 5 + [0.5] * 100) == 25
