"""A sweep that is killed again and again, and then goes on, ends with the same bytes as one that was left alone."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time

from tdgbench.bench.record import read_all
from tests.conftest import ROOT
from tests.test_main import QUICK, command

KILLS = 4
SWEEP = ("method=splat,tdg", "scene=turntable,orbit", "budget.iterations=150")


def contents(experiment) -> dict[str, tuple]:
    """What must not depend on kills: everything of a record but times, memory and the machine."""
    return {
        r.title: (r.status, r.key, r.scores, r.hashes, r.gaussians, r.iterations, r.channels, r.views)
        for r in read_all(experiment)
    }


def test_killed_and_gone_on(tmp_path, data_root):
    sweep = ("-m", *QUICK, *SWEEP, f"data.root={data_root}")
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    for folder in (calm, killed):
        folder.mkdir()
    assert command(calm, *sweep).returncode == 0
    chance = random.Random(0)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TORCH_HOME": str(killed / "torch")}
    made: dict[str, float] = {}
    for _ in range(KILLS):
        call = [sys.executable, "-m", "tdgbench", *sweep, f"results={killed / 'results'}"]
        process = subprocess.Popen(
            call, cwd=killed, env=environment, start_new_session=True, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        time.sleep(chance.uniform(2.0, 7.0))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        there = {str(p): p.stat().st_mtime for p in (killed / "results").rglob("record.json")}
        assert made.items() <= there.items()  # nothing finished was lost or run again
        made = there
    assert command(killed, *sweep).returncode == 0
    assert contents(killed / "results" / "single") == contents(calm / "results" / "single")
    assert len(contents(killed / "results" / "single")) == 4
    assert not list((killed / "results" / "single" / "cells").rglob(".*"))
