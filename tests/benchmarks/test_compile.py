"""Times are the benchmark's business; here, that it runs and that the second process finds the first one's kernels."""

import subprocess
import sys

from benchmarks import compile as benchmark
from tests.helpers.paths import ROOT


def test_prints_the_seconds_of_a_process():
    command = [sys.executable, "-m", "benchmarks.compile", "--here", "--channels", "1"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[-2000:]
    assert float(run.stdout.split()[-1]) > 0


def test_both_processes_share_a_cache_folder_of_their_own(monkeypatch):
    folders = []

    def run(command, env, **_):
        assert command[-2:] == ["1", "3"] and "--here" in command
        folders.append(env["XDG_CACHE_HOME"])
        return subprocess.CompletedProcess(command, 0, stdout=f"note\n{10.0 / len(folders) ** 4}\n")

    monkeypatch.setattr(subprocess, "run", run)
    assert benchmark.seconds_of_two([1, 3]) == (10.0, 10.0 / 16)
    assert len(set(folders)) == 1
