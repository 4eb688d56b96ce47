import numpy as np
import pytest
import torch

from tdgbench.training.learned import BETA1, BETA2, EPS, LearnedRows

START = np.random.default_rng(0).normal(size=(3, 2, 4))


@pytest.mark.parametrize("decay", [0.0, 0.1])
def test_a_row_takes_the_steps_of_adamw(decay):
    rows = LearnedRows(START)
    theirs = torch.from_numpy(START[1].copy()).requires_grad_()
    optimizer = torch.optim.AdamW([theirs], lr=0.03, betas=(BETA1, BETA2), eps=EPS, weight_decay=decay)
    for number in range(5):
        gradient = np.random.default_rng(number).normal(size=(2, 4))
        rows.step(1, gradient, 0.03, decay)
        theirs.grad = torch.from_numpy(gradient)
        optimizer.step()
    assert rows.values[1] == pytest.approx(theirs.detach().numpy(), rel=1e-12)
    assert np.array_equal(rows.values[[0, 2]], START[[0, 2]]) and rows.steps.tolist() == [0, 5, 0]


def test_a_rate_of_each_parameter():
    rows = LearnedRows(np.zeros((1, 2)))
    rows.step(0, np.array([1.0, 1.0]), np.array([0.1, 0.0]), 0.0)
    assert rows.values[0] == pytest.approx([-0.1, 0.0])
