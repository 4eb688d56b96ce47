"""Each quantity of cells made by hand; levels reached and shocks at the switch."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest

from tdgbench.cells.record import Record
from tdgbench.tables.claims.evidence import Claim
from tdgbench.tables.claims.quantities import QUANTITIES, first_at, loss_rise, psnr_drop, time_to_level
from tdgbench.tables.results import Cell
from tests.tables.claims.small_cells import cell, paper_budget

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


def test_ratios_are_of_what_should_be_low():
    assert not [name for name, quantity in QUANTITIES.items() if quantity.ratio and quantity.higher]


CLAIM = Claim(id="", said="", where="", check="better", level=0.5, window=0.1)


def with_log(folder, name, psnr, loss=None, decay_end=0.5):
    """A cell of 100 iterations, ten lines apart."""
    (folder / name).mkdir()
    log = pd.DataFrame({"iteration": range(10, 10 * len(psnr) + 1, 10), "smoothed_psnr": psnr})
    log = log.assign(seconds=log["iteration"] / 5, loss=1, gaussians=9)
    log["loss_thermal"] = 0.1 if loss is None else loss
    log.to_csv(folder / name / "log.csv", index=False)
    record = Record("tdg", "d", "s", "colmap", 0, "e", "", iterations=100)
    record.config = {"budget": {"iterations": 100}, "method": {"method": {"decay_end": decay_end}}}
    return Cell(folder / name, record)


def test_the_level_is_part_of_the_way_to_the_worse_runs_best(tmp_path):
    fast = with_log(tmp_path, "fast", [10, 20, 30, 40])
    slow = with_log(tmp_path, "slow", [10, 12, 18, 22, 20])
    # from 10 to 22, half of the way: 16
    assert time_to_level(fast, slow, CLAIM, "iteration") == pytest.approx((16, 20 + 10 * 4 / 6))
    assert time_to_level(slow, fast, CLAIM, "seconds") == pytest.approx(((20 + 10 * 4 / 6) / 5, 16 / 5))


def test_without_a_level_there_is_no_progress(tmp_path):
    fast = with_log(tmp_path, "fast", [10, 20])
    assert time_to_level(fast, with_log(tmp_path, "flat", [10, 9]), CLAIM, "iteration") is None
    assert time_to_level(fast, Cell(tmp_path / "nothing", fast.record), CLAIM, "iteration") is None


def test_a_level_reached_at_once_and_never(tmp_path):
    log = with_log(tmp_path, "x", [10, 20]).log
    assert first_at(log, 5.0, "iteration") == 10
    assert first_at(log.assign(psnr=log["smoothed_psnr"] + 10), 25.0, "smoothed_psnr", "psnr") == 15.0
    with pytest.raises(ValueError, match=r"never reaches 50\.00 dB; it ends at 20\.00 dB"):
        first_at(log, 50.0, "iteration")


def test_the_shock_is_looked_for_around_the_switch_alone(tmp_path):
    psnr = [20, 20, 20, 30, 34, 32, 5, 40, 40, 40]  # the switch at 50: before is 40, after is 50 and 60
    loss = [1, 1, 1, 0.2, 0.3, 0.5, 9, 1, 1, 1]
    cell = with_log(tmp_path, "x", psnr, loss)
    assert psnr_drop(cell, CLAIM) == 30 - 32
    assert loss_rise(cell, CLAIM) == 2.5
    assert psnr_drop(cell, replace(CLAIM, window=0.2)) == (20 + 30) / 2 - 5
    assert psnr_drop(cell, replace(CLAIM, window=0.0)) is None


def test_the_switch_is_that_of_a_budget_that_expects_an_early_end(tmp_path):
    cell = with_log(tmp_path, "x", [20, 20, 30, 5, 34, 32, 31, 40, 40, 40])
    cell.record.config["budget"] = paper_budget(iterations=100, expected_iterations=60)  # the switch at 30
    assert psnr_drop(cell, replace(CLAIM, window=0.2)) == 20 - 5


def test_without_a_switch_there_is_no_shock(tmp_path):
    assert psnr_drop(with_log(tmp_path, "x", [1, 2, 3], decay_end=None), CLAIM) is None
    cell = with_log(tmp_path, "y", [1, 2, 3])
    assert loss_rise(Cell(tmp_path / "nothing", cell.record), CLAIM) is None
