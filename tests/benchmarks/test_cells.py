"""The benchmark of cells: its parts at a small size."""

import pytest

from benchmarks import cells
from tests.helpers.command import program_here


def test_scoring_is_timed_on_one_thread_and_on_all(tmp_path, monkeypatch):
    monkeypatch.setattr(cells.pool, "available_cores", lambda: 3)
    times = cells.time_scoring("squeeze", 3, (40, 36), 2)
    assert {threads: len(seconds) for threads, seconds in times.items()} == {1: 2, 3: 2}
    assert all(one > 0 for seconds in times.values() for one in seconds)


@pytest.mark.parametrize(("seconds", "status"), [([1.2, 1.3], 0), ([2.0, 2.1], 1)])
def test_scoring_that_gains_nothing_is_a_failure(tmp_path, monkeypatch, seconds, status):
    monkeypatch.setattr(cells, "time_scoring", lambda *args: {1: [2.0, 2.0], 2: seconds})
    assert program_here(cells.main, tmp_path, "cells").returncode == status
