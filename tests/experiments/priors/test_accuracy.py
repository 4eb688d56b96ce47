import numpy as np
import pytest

from tdgbench.experiments.priors.accuracy import accuracy, aligned

RNG = np.random.default_rng(0)
Z = RNG.uniform(1, 5, 400)


@pytest.mark.parametrize(
    ("kind", "values"), [("depth", 3 * Z - 7), ("disparity", 0.2 / Z + 5), ("metric", 40 * Z)], ids=str
)
def test_a_prior_that_is_right_up_to_what_its_kind_leaves_open(kind, values):
    found = accuracy(values.astype(np.float32), kind, Z)
    assert found.abs_rel < 1e-4 and found.delta == 1 and found.rank == pytest.approx(1, abs=1e-4)


def test_a_wrong_kind_is_not_right():
    assert accuracy(1 / Z, "depth", Z).abs_rel > 0.1 and accuracy(1 / Z, "depth", Z).rank == pytest.approx(-1)
    assert accuracy(Z + 3, "metric", Z).abs_rel > 0.1  # a metric depth has no shift


def test_numbers_by_hand():
    """z = 1, 2, 4; the prior has 1, 2, 3: with its median, that is 0, 0 and a quarter off; 4 / 3 is above 1.25."""
    found = accuracy(np.array([1.0, 2.0, 3.0]), "metric", np.array([1.0, 2.0, 4.0]))
    assert found.abs_rel == pytest.approx(0.25 / 3) and found.delta == pytest.approx(2 / 3) and found.rank == 1


def test_the_alignment_is_the_least_squares_fit():
    values = 1 / Z + RNG.normal(0, 0.02, len(Z))
    slope, shift = np.polyfit(values, 1 / Z, 1)
    assert np.allclose(aligned(values, "disparity", Z), np.clip(1 / (slope * values + shift), Z.min(), Z.max()))


def test_a_flat_map_has_no_rank_and_a_useless_one_stays_in_range():
    assert np.isnan(accuracy(np.ones(400), "depth", Z).rank)
    useless = accuracy(RNG.normal(size=400), "disparity", Z)
    assert abs(useless.rank) < 0.2 and 0.2 < useless.abs_rel < 1.0
