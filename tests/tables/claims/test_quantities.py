"""Each quantity of cells made by hand."""

from dataclasses import replace

import pandas as pd
import pytest

from tdgbench.tables.claims.evidence import Claim
from tdgbench.tables.claims.quantities import QUANTITIES
from tests.tables.claims.small_cells import cell

CLAIM = Claim(id="", said="", where="", check="better", level=0.95, window=0.05)


@pytest.mark.parametrize(
    ("name", "better", "other"),
    [
        ("psnr", 33.0, 30.0),
        ("rgb_psnr", 33.0, 30.0),
        ("dssim", 0.05, 0.1),
        ("lpips", 0.05, 0.1),
        ("floaters", 0.3, 0.4),
        ("depth_abs_rel", 0.05, 0.1),
        ("train_psnr", 40.0, 40.0),
        ("overfit", 7.0, 10.0),
        ("train_hours", 50.0, 100.0),
        ("added", 500, 1000),
        ("pruned", 250, 500),
        ("gaussians", 2000, 4000),
    ],
)
def test_numbers_of_both_cells(tmp_path, name, better, other):
    quantity = QUANTITIES[name]
    cells = cell(tmp_path, gain=1.0), cell(tmp_path, gain=0.0)
    assert quantity.numbers(*cells, CLAIM) == pytest.approx((better, other))
    assert quantity.higher == (better > other or name == "train_psnr")
    for one in cells:
        one.record.scores, one.record.train_scores, one.record.seconds = {}, {}, {}
        one.record.parts = {}
    assert quantity.numbers(*cells, CLAIM) is None


def test_consistency_counts_where_there_is_no_truth(tmp_path):
    cells = cell(tmp_path, gain=1.0), cell(tmp_path, gain=0.0)
    assert QUANTITIES["depth_inconsistency"].numbers(*cells, CLAIM) is None
    for one in cells:
        one.record.scores["depth_abs_rel"] = None
    assert QUANTITIES["depth_inconsistency"].numbers(*cells, CLAIM) == pytest.approx((0.05, 0.1))


def test_consistency_is_over_views_that_both_cells_have(tmp_path):
    cells = cell(tmp_path), cell(tmp_path)
    for one, values in zip(cells, ([0.1, 0.3, "n/a", 0.2, 1.2], ["n/a", 0.5, 0.7, 0.0, 0.5]), strict=True):
        one.record.scores["depth_abs_rel"] = None
        table = pd.DataFrame({"view": list("abcde"), "depth_inconsistency": values})
        table.to_csv(one.folder / "views.csv", index=False)
    assert QUANTITIES["depth_inconsistency"].numbers(*cells, CLAIM) == pytest.approx((0.6, 0.5))  # views b and e
    other = replace(cells[1], folder=tmp_path / "nothing")
    assert QUANTITIES["depth_inconsistency"].numbers(cells[0], other, CLAIM) is None


def test_training_curves(tmp_path):
    cells = cell(tmp_path, gain=1.0), cell(tmp_path, gain=0.0)
    fast, slow = QUANTITIES["iterations_to_level"].numbers(*cells, CLAIM)
    assert slow / fast == pytest.approx(2, rel=0.05)
    assert QUANTITIES["seconds_to_level"].numbers(*cells, CLAIM) == pytest.approx((fast / 100, slow / 100), rel=0.05)
    calm, shaken = QUANTITIES["psnr_drop"].numbers(*cells, CLAIM)
    assert shaken - calm == pytest.approx(1.0, abs=0.1)
    assert QUANTITIES["loss_rise"].numbers(*cells, CLAIM) == pytest.approx((1.5, 2.0))


def test_ratios_are_of_what_should_be_low():
    assert not [name for name, quantity in QUANTITIES.items() if quantity.ratio and quantity.higher]
