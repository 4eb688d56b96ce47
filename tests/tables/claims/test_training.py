"""Levels reached and shocks at the switch, in logs made by hand."""

from dataclasses import replace

import pandas as pd
import pytest

from tdgbench.cells.record import Record
from tdgbench.tables.cell import Cell
from tdgbench.tables.claims.evidence import Claim
from tdgbench.tables.claims.quantities import first_at, loss_rise, psnr_drop, time_to_level

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
    cell.record.config["budget"]["expected_iterations"] = 60  # the switch at 30
    assert psnr_drop(cell, replace(CLAIM, window=0.2)) == 20 - 5


def test_without_a_switch_there_is_no_shock(tmp_path):
    assert psnr_drop(with_log(tmp_path, "x", [1, 2, 3], decay_end=None), CLAIM) is None
    cell = with_log(tmp_path, "y", [1, 2, 3])
    assert loss_rise(Cell(tmp_path / "nothing", cell.record), CLAIM) is None
