"""Whatever fails in a cell is an outcome and, where it can be written, a record."""

import errno
import shutil

import pytest

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.bench.cell_phases import CellRun
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import cell_lock
from tdgbench.cells.record import read_all
from tdgbench.training.checkpoint import Checkpoint
from tests.helpers.cells import fails, statuses


def test_a_failure_that_is_no_json_leaves_a_record(tiny_cell, monkeypatch):
    def note(self, *_):
        self.record.init_points = {"box": [float("nan"), object()]}

    monkeypatch.setattr(GaussianSplatting, "setup", fails(ValueError("lone surrogate \udcff, NUL \0")))
    monkeypatch.setattr(CellRun, "note", note)
    assert tiny_cell().status == "failed"
    (record,) = read_all(tiny_cell.experiment)
    assert record.status == "failed" and record.init_points["box"][0] == "nan"


@pytest.mark.parametrize("option", ["seed=abc", "seed=1.5", "seed=null", "seed=true"])
def test_options_that_name_no_cell_fail_without_a_record(tiny_cell, option):
    outcome = tiny_cell(option)
    assert outcome.status == "failed" and outcome.message.startswith("seed") and "3dgs on turntable" in outcome.title
    assert not (tiny_cell.experiment / "cells").exists()


def test_ctrl_c_passes_and_releases_the_lock(tiny_cell, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(GaussianSplatting, "step", fails(KeyboardInterrupt()))
        with pytest.raises(KeyboardInterrupt):
            tiny_cell()
    assert not (tiny_cell.experiment / "cells").exists()
    with cell_lock(tiny_cell.experiment, tiny_cell.folder) as acquired:
        assert acquired
    assert tiny_cell().status == "ok"


def test_clearing_up_changes_no_outcome(tiny_cell, monkeypatch):
    def broken(*_):
        raise OSError(errno.EIO, "Input/output error", "checkpoint.pt")

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "discard", broken)
        patch.setattr(CellProgress, "end", broken)
        outcome = tiny_cell()
    assert outcome.status == "ok"
    assert "its checkpoint could not be removed" in outcome.message and "clearing up" in outcome.message
    assert statuses(tiny_cell.experiment) == ["ok"] and tiny_cell().status == "kept"


@pytest.mark.parametrize("junk", ["locks", "lock"])
def test_damaged_locks_fail_with_their_name(tiny_cell, junk):
    assert tiny_cell().status == "ok"
    locks = tiny_cell.experiment / "locks"
    if junk == "locks":
        shutil.rmtree(locks)
        locks.touch()
    else:
        (lock,) = locks.iterdir()
        lock.unlink()
        lock.mkdir()
    outcome = tiny_cell()
    assert outcome.status == "failed" and str(locks) in outcome.message and "remove" in outcome.message
    assert statuses(tiny_cell.experiment) == ["ok"]


def test_priors_are_estimated_without_a_cache(tiny_cell):
    cache = tiny_cell.experiment.parent / "cache"
    cache.parent.mkdir(parents=True)
    cache.touch()
    outcome = tiny_cell("method=tdg")
    assert outcome.status == "ok" and "depth priors were not cached" in outcome.message
