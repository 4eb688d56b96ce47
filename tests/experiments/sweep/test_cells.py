"""Cells of a sweep: how many, how many are left, and for how long."""

from __future__ import annotations

from datetime import datetime

import pytest

from tdgbench.bench.outcome import Outcome
from tdgbench.experiments.sweep.cells import (
    FILE,
    PlannedCell,
    count_by_state,
    pending,
    read_cells,
    remaining_time,
    time_left,
    write_cells,
)

MORNING, EVENING = datetime(2026, 3, 1, 9, 30), datetime(2026, 3, 1, 22, 0)
SCENES = ("a", "b", "c")


def cells(state="to run"):
    """MSMG and TDg on three scenes, scene by scene."""
    return [PlannedCell(f"method={method}", scene, state) for scene in SCENES for method in ("msmg", "tdg")]


def ran(*seconds: float) -> dict[int, Outcome]:
    return {number: Outcome("ok", "", seconds=time) for number, time in enumerate(seconds)}


def test_cells_take_as_long_as_those_of_their_method():
    found = time_left(cells(), ran(3600, 600), workers=1)
    assert found == (2 * (3600 + 600), 2, ())
    assert time_left(cells(), ran(3600, 600, 1800, 300), workers=1).seconds == 2700 + 450


def test_other_seeds_of_a_scene_are_the_best_guess():
    seeds = [PlannedCell("method=tdg", scene, "to run") for scene in ("a", "b", "a", "b")]
    assert time_left(seeds, ran(100, 900), workers=1).seconds == 1000
    assert time_left(seeds, ran(100, 900, 100), workers=1).seconds == 900


def test_a_method_that_has_not_run_is_named():
    found = time_left(cells(), ran(3600), workers=1)
    assert found.seconds == 5 * 3600 and found.unknown == ("method=tdg",)
    assert remaining_time(cells(), ran(3600), 1, MORNING) == (
        "5 of 6 cells to go, about 5:00 h left (until 14:30), from 1 cell, none of them method=tdg"
    )


def test_workers_share_the_cells_but_not_a_cell():
    assert time_left(cells(), ran(3600, 3600), workers=2).seconds == 2 * 3600
    assert time_left(cells(), ran(3600, 3600), workers=16).seconds == 3600


def test_the_end_in_words():
    assert remaining_time(cells(), ran(3600, 600), 1, MORNING) == (
        "4 of 6 cells to go, about 2:20 h left (until 11:50), from 2 cells"
    )
    assert "(until 2026-03-02 00:20)" in remaining_time(cells(), ran(3600, 600), 1, EVENING)
    assert remaining_time(cells(), ran(*[60] * 6), 1, MORNING) == ""  # nothing is left
    assert remaining_time(cells(), {0: Outcome("failed", "")}, 1, MORNING) == ""  # and nothing is known
    assert remaining_time([], {-1: Outcome("ok", "", seconds=9.0)}, 1) == ""  # a single run


def test_results_count_as_finished_until_one_of_them_was_outdated():
    mixed = [*cells("with a result")[:4], *cells()[4:]]
    kept = {number: Outcome("kept", "") for number in range(3)}
    assert [cell.scene for cell in pending(mixed, kept)] == ["c", "c"]
    assert [cell.scene for cell in pending(mixed, {**kept, 3: Outcome("ok", "")})] == ["c", "c"]
    outdated = {0: Outcome("ok", "", seconds=60.0)}
    assert len(pending(mixed, outdated)) == 5


def test_cells_without_data_take_no_time():
    some = [*cells()[:2], PlannedCell("method=tdg", "c", "without data")]
    assert count_by_state(some) == "3 cells: 2 to run, 0 with a result, 1 without data"
    assert time_left(some, ran(60), workers=1).seconds == 60


def test_the_file(tmp_path):
    write_cells(tmp_path, cells())
    assert read_cells(tmp_path) == cells()
    assert read_cells(tmp_path / "nothing") == []
    for content in ("{", "[3]", '[{"kind": "a", "scene": "b", "state": "unheard of"}]'):
        (tmp_path / FILE).write_text(content, encoding="utf-8")
        assert read_cells(tmp_path) == []


@pytest.mark.parametrize("state", ["to run", "with a result", "without data"])
def test_counts_each_state(state):
    assert f"6 {state}" in count_by_state(cells(state))
