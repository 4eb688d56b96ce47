"""The benchmark of cells: its parts at a small size."""

import pytest

from benchmarks import cells
from tests.helpers.command import program_here


def test_scoring_is_timed_on_one_thread_and_on_all(tmp_path, monkeypatch):
    monkeypatch.setattr(cells.pool, "available_cores", lambda: 3)
    times = cells.time_scoring("squeeze", 3, (40, 36), 2)
    assert {threads: len(seconds) for threads, seconds in times.items()} == {1: 2, 3: 2}
    assert all(one > 0 for seconds in times.values() for one in seconds)


@pytest.mark.parametrize(("told", "status"), [(1.0, 0), (3.5, 1)])
def test_a_slow_repetition_is_a_failure(tmp_path, monkeypatch, told, status):
    runs = iter([50.0, 10.0, told, 10.0, told, 10.0, told, 10.0])
    stamp = tmp_path / "results" / "single" / cells.FILE

    def run(folder):
        stamp.parent.mkdir(parents=True, exist_ok=True)
        stamp.write_text("{}")
        return next(runs)

    monkeypatch.setattr(cells, "_run", run)
    monkeypatch.setattr(cells.tempfile, "TemporaryDirectory", lambda: Kept(tmp_path))
    run = program_here(cells.main, tmp_path, "cells", "--parts", "again")
    assert (
        run.returncode == status
        and f"28 cells again: {told:.2f} s" in run.stdout
        and f"ratio {told / 10:.2f}" in run.stdout
    )


@pytest.mark.parametrize(("seconds", "status"), [([1.2, 1.3], 0), ([2.0, 2.1], 1)])
def test_scoring_that_gains_nothing_is_a_failure(tmp_path, monkeypatch, seconds, status):
    monkeypatch.setattr(cells, "time_scoring", lambda *args: {1: [2.0, 2.0], 2: seconds})
    assert program_here(cells.main, tmp_path, "cells", "--parts", "scoring").returncode == status


class Kept:
    """A temporary folder that stays."""

    def __init__(self, folder):
        self.folder = folder

    def __enter__(self):
        return str(self.folder)

    def __exit__(self, *_):
        pass


def test_the_sweep_has_as_many_cells_as_the_main_table():
    count = 1
    for word in cells.SWEEP:
        count *= word.count(",") + 1
    assert count == 28
