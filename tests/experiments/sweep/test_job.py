from __future__ import annotations

import json
import subprocess
import sys
from datetime import datetime

import pytest
from omegaconf import OmegaConf

from tdgbench.bench.run_cell import Outcome
from tdgbench.cells.plan import Plan
from tdgbench.cells.record import read_all
from tdgbench.experiments.sweep.run import OUTCOME, read_outcomes, remaining_time, worker_threads
from tests.helpers.command import command_here
from tests.helpers.configs import QUICK


def test_outcomes_come_in_the_order_of_the_jobs(tmp_path):
    for number in (10, 2, 0):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / OUTCOME).write_text(json.dumps({"status": "ok", "title": str(number), "message": ""}))
    assert read_outcomes(tmp_path) == [Outcome("ok", t) for t in ("0", "2", "10")]
    assert read_outcomes(tmp_path / "nothing") == []


@pytest.mark.parametrize(
    ("launcher", "cells", "threads"),
    [({}, 20, None), ({"n_jobs": 2}, 20, 4), ({"n_jobs": -1}, 20, 1), ({"n_jobs": 16}, 20, 1), ({"n_jobs": 3}, 20, 2),
     ({"n_jobs": 1}, 20, 8), ({"cpus_per_task": 3}, 20, 3), ({"ray": {"remote": {}}}, 20, 1),
     ({"ray": {"remote": {"num_cpus": 4}}}, 20, 4), ({"n_jobs": -1}, 4, 2), ({"n_jobs": 4}, 2, 4),
     ({"n_jobs": -1}, 0, 1), ({"n_jobs": 4}, 0, 2)],
)  # fmt: skip
def test_workers_share_the_cores(launcher, cells, threads):
    assert worker_threads(OmegaConf.create(launcher), 8, cells) == threads


def test_time_left_is_that_of_the_mean_finished_cell():
    noon = datetime(2024, 1, 1, 12)
    done = [Outcome("ok", "a", seconds=600.0), Outcome("ok", "b", seconds=1800.0), Outcome("kept", "c")]
    assert "5 of 9 cells to go, about 0:50:00 left" in remaining_time(9, [*done, Outcome("failed", "d")], 2, noon)
    assert "1 of 4 cells to go, about 0:20:00 left" in remaining_time(4, done, 4, noon)  # a cell has one worker
    assert remaining_time(3, done, 1) == remaining_time(2, done, 1) == remaining_time(9, done[2:], 1) == ""


def test_a_job_without_a_readable_outcome_has_failed(tmp_path):
    for number, content in enumerate(
        ("{", json.dumps({"status": "ok", "title": "b", "message": ""}), '{"status": "good"}')
    ):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / OUTCOME).write_text(content, encoding="utf-8")
    outcomes = read_outcomes(tmp_path, jobs=4)
    assert [outcome.status for outcome in outcomes] == ["failed", "ok", "failed", "failed"]
    assert "outcome.json is no outcome" in outcomes[0].message and "left no outcome" in outcomes[3].message
    assert [outcome.status for outcome in read_outcomes(tmp_path / "nothing", jobs=1)] == ["failed"]


@pytest.mark.parametrize(
    ("swept", "wrong", "records"),
    [
        ("seed=abc,1", "seed=abc: must be a valid integer", 1),  # there is no cell of seed abc
        ("method.method.weight=inf,0.5", "weight=inf: must be", 2),
    ],
)
def test_a_job_with_a_wrong_option_fails_alone(tmp_path, data_root, swept, wrong, records):
    run = command_here(tmp_path, "-m", "method=3dgs", "scene=turntable", f"data.root={data_root}", *QUICK, swept)
    assert run.returncode == 1 and "1 cell run, 0 already there, 1 failed" in run.stdout, run.stderr[-3000:]
    assert "failed: " in run.stdout and wrong in run.stdout
    assert len(read_all(tmp_path / "results" / "single")) == records
    assert (tmp_path / "results" / "single" / "report.html").exists()


def test_a_plan_that_another_sweep_replaces_does_not_merge_cells(tmp_path, data_root, monkeypatch):
    """Two sweeps in one folder: the jobs of one keep to its own plan."""
    write = Plan.write

    def write_and_lose(self, folder):
        write(self, folder)
        if folder.name == "single":
            (folder / "experiment.json").write_text("{", encoding="utf-8")

    monkeypatch.setattr(Plan, "write", write_and_lose)
    sweep = ("budget.iterations=4,6", "method=3dgs", "scene=turntable", f"data.root={data_root}")
    run = command_here(tmp_path, "-m", *QUICK, *sweep)
    assert "2 cells run" in run.stdout and "experiment.json is not the plan of a sweep" in run.stdout
    assert len(read_all(tmp_path / "results" / "single")) == 2


CODE = """
import sys
import methods.msmg, methods.tdg, tdgbench.bench.run_cell, tdgbench.experiments.sweep.run
print([name for name in ("matplotlib", "pandas", "scipy.stats") if name in sys.modules])
"""


def test_no_library_of_the_tables_is_there_before_they_are_made():
    found = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"
