"""A sweep that is ended several times and resumed ends with the bytes of an undisturbed one."""

from __future__ import annotations

import pytest

from benchmarks.killed import SMALL
from tdgbench.experiments.measure.kill.sweep import Plan, Sweep, kill_many


def test_killed_and_resumed(tmp_path):
    words = [word for word in SMALL if not word.startswith(("method=", "scene="))]
    sweep = Sweep([*words, "method=tdg", "scene=turntable"], "single", tmp_path)
    calm = sweep.run_calm(warm_up=False)
    kills = kill_many(sweep, calm._replace(seconds=0.8 * calm.seconds), Plan(3, full_disk=0.4, seed=4))
    assert [kill.problems for kill in kills] == [[], [], []], kills


@pytest.mark.slow
def test_a_longer_sweep(tmp_path):
    sweep = Sweep(list(SMALL), "single", tmp_path)
    kills = kill_many(sweep, sweep.run_calm(), Plan(10))
    assert not any(kill.problems for kill in kills), kills
