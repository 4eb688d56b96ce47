"""A seeded part of the fuzzing suite: cases of every kind, none of which breaks."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest

from benchmarks.fuzz import __main__ as fuzz
from benchmarks.fuzz.case import Change, find_kinds
from benchmarks.fuzz.kinds import scene
from benchmarks.fuzz.suite import draw
from tests.helpers.command import program_here

FAST = {"colmap-old": 10, "colmap-new": 10, "colmap-text": 6, "images": 8, "temperature": 5, "depth": 5, "ply": 5}
OTHERS = 2  # cases of each other kind: most run whole cells


def seeded_part():
    """The first cases of seed 0 of each kind."""
    wanted = Counter({name: FAST.get(name, OTHERS) for name in find_kinds()})
    for drawn in (draw(0, number) for number in itertools.count()):
        if wanted[drawn.kind.name]:
            wanted[drawn.kind.name] -= 1
            yield drawn
        if not wanted.total():
            return


def test_no_case_breaks(tmp_path, monkeypatch):
    monkeypatch.setattr(fuzz, "_cases", lambda args, end: seeded_part())
    monkeypatch.setattr(scene, "WHOLE", 0.0)  # no sweeps of two scenes, which take seconds each
    run = program_here(fuzz.main, tmp_path, "fuzz", "--keep", str(tmp_path / "keep"))
    assert run.returncode == 0, run.stdout + run.stderr
    assert "cases broke" in run.stdout and "peak memory" in run.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", find_kinds())
def test_good_inputs_give_results(tmp_path, monkeypatch, name):
    """Without mutation, every kind gives a result: no oracle objects to a good input."""
    monkeypatch.setattr(find_kinds()[name], "mutate", lambda self, rng: Change("nothing", ()))
    run = program_here(fuzz.main, tmp_path, "fuzz", "--kind", name, "--cases", "1", "--keep", str(tmp_path / "keep"))
    assert run.returncode == 0 and "none of 1 cases broke" in run.stdout, run.stdout + run.stderr


def test_a_single_case_runs_again(tmp_path):
    number = next(number for number in itertools.count() if draw(0, number).kind.name == "ply")
    run = program_here(fuzz.main, tmp_path, "fuzz", "--case", str(number), "--kind", "ply")
    assert f"case {number}, ply" in run.stdout, run.stderr
