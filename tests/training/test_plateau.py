import numpy as np
import pytest
import torch

from tdgbench.training.plateau import Plateau, PlateauRule


def stops_at(losses, **rule):
    plateau = Plateau(PlateauRule(**{"epochs": 1, "patience": 2, "gain": 0.01, "after": 0, **rule}), views=5)
    return next((i for i, loss in enumerate(losses, start=1) if plateau.reached(i, loss)), None)


def test_losses_of_a_gpu_decide_as_numbers_do():
    losses = torch.rand(60, generator=torch.Generator().manual_seed(0)) + 1
    rule = PlateauRule(epochs=1, patience=9, gain=0.0, after=3)
    of_numbers, of_tensors = (Plateau(rule, views=5) for _ in range(2))
    for i, loss in enumerate(losses, start=1):
        assert of_tensors.reached(i, loss.double()) == of_numbers.reached(i, loss.item())
        assert of_tensors.state_dict() == of_numbers.state_dict()
    assert type(of_tensors.state_dict()["_sum"]) is float


def test_a_falling_loss_goes_on():
    assert stops_at([0.99**i for i in range(200)]) is None


def test_a_flat_loss_stops_after_its_patience():
    assert stops_at([1.0] * 100) == 15  # one window to compare with, two that are no better
    assert stops_at([1.0] * 100, patience=3) == 20
    assert stops_at([1.0] * 100, after=30) == 45
    assert stops_at([1.0] * 100, epochs=2) == 30


def test_one_better_window_starts_the_patience_anew():
    assert stops_at([1.0] * 10 + [0.5] * 5 + [0.5] * 100) == 25


@pytest.mark.parametrize("seed", range(5))
def test_windows_hold_whole_rounds_of_views(seed):
    """Losses differ from view to view, not from round to round, whose orders are random; `after` ends within one."""
    rng, of_views = np.random.default_rng(seed), [1.0, 2.0, 4.0, 8.0, 16.0]
    losses = np.concatenate([rng.permutation(of_views) for _ in range(40)])
    assert stops_at(losses, after=3, gain=1e-6) == 5 + 3 * 5
    assert stops_at(losses, after=5, gain=1e-6, epochs=2) == 5 + 3 * 10
