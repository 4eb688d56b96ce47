"""The kill suite finds what it looks for; a sweep that is ended several times ends with the same bytes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from benchmarks.killed import sweep as module
from benchmarks.killed.__main__ import SMALL
from benchmarks.killed.sweep import Calm, Plan, Sweep, kill_many

# A sweep of three cells of 0.1 s each; its argument says what is broken about it.
FAKE = """
import json, signal, sys, time
from pathlib import Path
broken, experiment = sys.argv[1], Path(sys.argv[2]) / "single"
for number in () if broken == "status" else (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda number, _: sys.exit(128 + number))
experiment.mkdir(parents=True, exist_ok=True)
(experiment / "experiment.json").write_text("{}")
for name in "abc":
    record = experiment / "cells" / name / "record.json"
    time.sleep(0.1 if not record.exists() else 0)
    if not record.exists() or broken == "twice":
        record.parent.mkdir(parents=True, exist_ok=True)
        record.write_text(json.dumps({"status": "ok"}))
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)  # the interpreter resets them while it shuts down
sys.exit(3 if broken == "last" else 0)
"""


class FakeSweep(Sweep):
    """A sweep that starts at once."""

    def start(self, results, full_at=None):
        with results.with_name(f"{results.name}.log").open("wb") as out:
            command = [sys.executable, "-c", FAKE, self.words[0], str(results)]
            return subprocess.Popen(command, start_new_session=True, stdout=out, stderr=subprocess.STDOUT)


@pytest.mark.parametrize(
    ("broken", "said"),
    [("nothing", ""), ("twice", "lost or written again"), ("status", "not 14"), ("last", "ended with status 3")],
)
def test_what_is_broken_is_found(tmp_path, monkeypatch, broken, said):
    monkeypatch.setattr(module, "compare", lambda calm, killed: [])
    signals = ("SIGTERM",) if broken == "status" else module.SIGNALS
    plan = Plan(6, signals, full_disk=0.0, seed=1)
    kills = kill_many(FakeSweep([broken], "single", tmp_path), Calm(tmp_path, 0.45, 0), plan)
    problems = [problem for kill in kills for problem in kill.problems]
    assert any(said in problem for problem in problems) if said else not problems, problems
    assert len(kills) == 6


@pytest.mark.slow
def test_killed_and_resumed(tmp_path):
    words = [word for word in SMALL if not word.startswith(("method=", "scene="))]
    sweep = Sweep([*words, "method=tdg", "scene=turntable"], "single", tmp_path)
    calm = sweep.run_calm(warm_up=False)
    kills = kill_many(sweep, calm._replace(seconds=0.8 * calm.seconds), Plan(2, full_disk=0.4, seed=4))
    assert [kill.problems for kill in kills] == [[], []], kills
    assert [kill.how for kill in kills] == ["full disk", "SIGKILL"]
