"""The simulation of verdicts: no verdict is wrong too often; a rule by the noise of one run would be."""

import pytest

from benchmarks.verdicts import OFFSETS, SEEDS, error_rates, simulate

DRAWS = 10_000


def test_no_verdict_is_wrong_in_more_than_5_percent():
    found = error_rates(DRAWS)
    assert len(found) == len(OFFSETS) * len(SEEDS)
    wrong = found[[column for column in found if column.startswith("wrong")]]
    assert wrong.to_numpy().max() <= 0.05 + 0.009  # four standard errors
    assert (found[found["seeds"] == 1]["undecided"] == 1).all()
    assert found.query("offset == 0 and seeds == 10")["reproduced"].item() > 0.9
    assert found.query("offset == 0.5 and seeds == 10")["better"].item() > 0.99


@pytest.mark.parametrize(("offset", "seeds", "rate"), [(1.0, 2, 0.67), (1.0, 3, 0.17), (0.5, 2, 0.83), (0.5, 3, 0.63)])
def test_a_rule_by_the_noise_of_one_run_would_call_nearly_everything_reproduced(offset, seeds, rate):
    assert simulate(offset, seeds, DRAWS)["within noise"] == pytest.approx(rate, abs=0.025)


def test_worse_mirrors_better():
    up, down = simulate(0.5, 3, DRAWS), simulate(-0.5, 3, DRAWS)
    assert down["worse"] == pytest.approx(up["better"], abs=0.03) and down["wrong worse"] == 0
