"""A child ends by itself, or its limits end it; nothing of it is left."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from benchmarks.fuzz.child import Child, Limits, tree_megabytes


def run(work, folder, limits=None):
    child = Child(work, folder, limits or Limits(seconds=10))
    while (ran := child.poll()) is None:
        time.sleep(0.01)
    return ran


def _raise():
    raise KeyError("a key")


def _stop():
    raise SystemExit("stopped")


@pytest.mark.parametrize(
    ("work", "status", "said"),
    [(lambda: 0, 0, ""), (lambda: None, 0, ""), (lambda: 3, 3, ""), (_stop, 1, "stopped"), (_raise, 1, "Traceback")],
)
def test_ends_as_a_process_does(tmp_path, work, status, said):
    ran = run(work, tmp_path)
    assert (ran.ending, ran.status) == ("ended", status) and said in ran.output


def test_runs_in_its_folder_and_its_output_is_kept(tmp_path):
    ran = run(lambda: print(Path.cwd()), tmp_path)
    assert ran.output.strip() == str(tmp_path)


def test_a_signal_is_seen(tmp_path):
    ran = run(lambda: os.kill(os.getpid(), signal.SIGSEGV), tmp_path)
    assert (ran.ending, ran.status) == ("signal", None)


def test_time_is_limited_also_where_signals_are_ignored(tmp_path):
    def sleep():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(60)

    ran = run(sleep, tmp_path, Limits(seconds=0.3))
    assert ran.ending == "hang" and ran.seconds < 5


def test_memory_is_limited(tmp_path):
    def eat():
        eaten = []
        while True:
            eaten.append(b"x" * 10_000_000)

    limit = 1500 + round(tree_megabytes(os.getpid()))  # a fork begins with the memory of this process
    ran = run(eat, tmp_path, Limits(seconds=20, megabytes=limit))
    assert ran.ending == "memory" and limit < ran.megabytes < limit + 1500


def test_memory_of_descendants_counts(tmp_path):
    def eat():
        if os.fork() == 0:
            held = b"x" * 600_000_000
            time.sleep(60)
            del held
        time.sleep(60)

    here = tree_megabytes(os.getpid())
    assert run(eat, tmp_path, Limits(seconds=20, megabytes=int(here) + 400)).ending == "memory"


def test_a_single_large_allocation_fails_in_the_child(tmp_path):
    ran = run(lambda: len(bytearray(50 * 2**30)), tmp_path)
    assert ran.status == 1 and "MemoryError" in ran.output
