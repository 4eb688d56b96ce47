"""Pairs, their intervals and verdicts."""

import numpy as np
import pytest
from scipy import stats

from tdgbench.tables.claims.cell_pairs import Interval, Side, all_of, gain_interval, judge_gain, make_pairs
from tdgbench.tables.claims.evidence import FAILS, HOLDS, UNDECIDED, Finding
from tests.tables.claims.small_cells import cell, ours

TDG, SMOOTH = Side("tdg", "colmap"), Side("3dgs_smooth", "colmap")


def test_cells_pair_where_nothing_else_differs(tmp_path):
    mine = cell(tmp_path, "tdg", seed=1)
    other = cell(tmp_path, "3dgs_smooth", seed=1)
    lone = [
        cell(tmp_path, "3dgs_smooth", seed=2),
        cell(tmp_path, "3dgs_smooth", seed=1, scene="b"),
        cell(tmp_path, "3dgs_smooth", seed=1, iterations=3000),
        cell(tmp_path, "3dgs_smooth", seed=1, init="random"),
    ]
    assert [tuple(pair) for pair in make_pairs(ours(*lone, mine, other), TDG, SMOOTH)] == [(mine, other)]
    assert make_pairs(ours(mine, *lone), TDG, SMOOTH) == []


@pytest.mark.parametrize(
    "change",
    [
        {"data": "other"},
        {"split": "folder"},
        {"config": {"budget": {"iterations": 900}, "method": {}}},
        {"config": {"skip": {"sh": True}}},
        {"backend": "gsplat"},
        {"protocol": "2-a"},
        {"code": "other"},
    ],
)
def test_what_keeps_cells_apart(tmp_path, change):
    mine, other = cell(tmp_path, "tdg"), cell(tmp_path, "3dgs_smooth")
    mine.record.config = other.record.config = {"budget": {"iterations": 1000}, "method": {}}
    other.record.iterations = 700  # where it settled
    assert len(make_pairs(ours(mine, other), TDG, SMOOTH)) == 1
    for name, value in change.items():
        setattr(other.record, name, value)
    assert make_pairs(ours(mine, other), TDG, SMOOTH) == []


def test_a_cell_of_two_experiments_counts_once(tmp_path):
    first, again = cell(tmp_path, "tdg"), cell(tmp_path, "tdg")
    other = cell(tmp_path, "3dgs_smooth")
    assert [tuple(pair) for pair in make_pairs(ours(first, again, other), TDG, SMOOTH)] == [(first, other)]


def test_the_interval_is_over_scenes_each_by_its_mean():
    scenes = [("d", s, seed) for s in "abc" for seed in (0, 1)]
    gains = [1.0, 3.0, 2.0, 6.0, 0.0, 0.0]
    found = gain_interval(scenes, gains)
    by_scene = [2.0, 4.0, 0.0]
    low, high = stats.t.interval(0.95, 2, np.mean(by_scene), stats.sem(by_scene))
    assert found == pytest.approx((2.0, low, high, 6, 3))


def test_with_one_scene_the_interval_is_over_its_seeds():
    gains = [1.0, 2.0, 4.0]
    low, high = stats.t.interval(0.95, 2, np.mean(gains), stats.sem(gains))
    assert gain_interval([("d", "a", seed) for seed in range(3)], gains) == pytest.approx(
        (np.mean(gains), low, high, 3, 1)
    )


@pytest.mark.parametrize(
    ("mean", "low", "high", "margin", "verdict"),
    [
        (1.0, 0.5, 1.5, 0.2, HOLDS),
        (0.3, 0.01, 0.59, 0.2, UNDECIDED),  # surely positive, perhaps too small
        (0.3, -0.1, 0.7, 0.2, UNDECIDED),
        (0.1, 0.05, 0.15, 0.2, FAILS),  # surely positive, and surely too small
        (0.0, 0.0, 0.0, 0.0, FAILS),
        (-1.0, -1.5, -0.5, 0.2, FAILS),
        (-0.5, -0.9, -0.1, -1.0, HOLDS),  # a loss within what the claim allows
        (-0.9, -1.1, -0.7, -1.0, UNDECIDED),
        (-2.0, -2.5, -1.5, -1.0, FAILS),
    ],
)
def test_judge(mean, low, high, margin, verdict):
    assert judge_gain(Interval(mean, low, high, 4, 4), margin) == verdict


@pytest.mark.parametrize(
    ("parts", "verdict"),
    [([HOLDS, HOLDS], HOLDS), ([HOLDS, UNDECIDED], UNDECIDED), ([UNDECIDED, FAILS], FAILS), ([HOLDS, FAILS], FAILS)],
)
def test_all_of(parts, verdict):
    found = all_of([Finding(part, f"part {i}") for i, part in enumerate(parts)])
    assert found.verdict == verdict and found.grounds == f"part 0 ({parts[0]}); part 1 ({parts[1]})"
    assert all_of([Finding(HOLDS, "alone")]) == Finding(HOLDS, "alone")
