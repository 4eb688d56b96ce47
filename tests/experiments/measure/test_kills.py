"""A sweep that is killed several times and resumed ends with the same bytes as an undisturbed one."""

from __future__ import annotations

import pytest

from tdgbench.bench.record import read_all
from tdgbench.experiments.measure.kills import compare, contents, run_killed
from tests.helpers.command import command, command_here
from tests.helpers.configs import QUICK

SWEEP = ("method=splat,tdg", "scene=turntable,orbit", "budget.iterations=700", "checkpoint=0")


@pytest.mark.slow
def test_killed_and_resumed(tmp_path, data_root):
    sweep = ["-m", *QUICK, *SWEEP, f"data.root={data_root}"]
    calm, killed = tmp_path / "results" / "single", tmp_path / "killed" / "single"
    run = command(tmp_path, *sweep)
    assert run.returncode == 0, run.stderr[-3000:]
    assert len(contents(calm)) == 4
    kills, wrong = run_killed(sweep, killed, 4, (4.0, 7.0))
    assert wrong == [] and compare(calm, killed) == []
    assert len(kills) == 4
    if any(kill.checkpoints for kill in kills):
        assert any(record.resumed for record in read_all(killed))


def test_a_difference_is_reported(tmp_path, data_root):
    quick = (*QUICK, "scene=turntable", "method=splat", f"data.root={data_root}")
    assert command_here(tmp_path, *quick).returncode == 0
    assert command_here(tmp_path, *quick, "seed=1", "name=other").returncode == 0
    results = tmp_path / "results"
    assert compare(results / "single", results / "single") == []
    assert len(compare(results / "single", results / "other")) == 2  # each has a cell that the other has not
    record = read_all(results / "other")[0]
    record.seed, record.experiment = 0, "single"
    record.write(results / "other" / "cells" / "splat" / "synthetic" / "turntable" / "colmap" / "seed1")
    assert {one.split(": ")[1].split()[0] for one in compare(results / "single", results / "other")} >= {
        "hashes",
        "key",
    }
    (results / "other" / "checkpoints").mkdir()
    (results / "other" / "checkpoints" / "a.pt").touch()
    assert any("leftover" in one for one in compare(results / "other", results / "other"))
