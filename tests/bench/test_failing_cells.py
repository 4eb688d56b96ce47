"""Whatever fails in a cell is an outcome and, where it can be written, a record."""

import errno
import shutil

import pytest

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.bench.cell_phases import CellRun
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import cell_lock
from tdgbench.cells.paths import short_name
from tdgbench.cells.record import Record, read_all
from tdgbench.training.checkpoint import Checkpoint
from tests.helpers.cells import fails, hidden, statuses


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


def test_no_stale_result_stands_for_a_failure(tiny_cell, monkeypatch):
    """Good, broken, good, broken: the failure is what the tables see each time."""
    for _ in range(2):
        assert tiny_cell("overwrite=always").status == "ok" and statuses(tiny_cell.experiment) == ["ok"]
        with monkeypatch.context() as patch:
            patch.setattr(GaussianSplatting, "step", fails(ValueError("broken")))
            outcome = tiny_cell("overwrite=always")
        assert outcome.status == "failed" and "could not be written" not in outcome.message
        assert statuses(tiny_cell.experiment) == ["failed"]
        assert len(hidden(tiny_cell.folder)) == 1
        assert [path.name for path in tiny_cell.folder.iterdir()] == ["record.json"]


def test_no_stale_result_stands_where_the_record_of_a_failure_cannot_be_written(tiny_cell, monkeypatch):
    assert tiny_cell().status == "ok"

    def full(self, folder):
        raise OSError(errno.ENOSPC, "full")

    with monkeypatch.context() as patch:
        patch.setattr(GaussianSplatting, "step", fails(ValueError("broken")))
        patch.setattr(Record, "write", full)
        outcome = tiny_cell("budget.iterations=11")
    assert outcome.status == "failed" and "its record could not be written" in outcome.message
    assert statuses(tiny_cell.experiment) == [] and len(hidden(tiny_cell.folder)) == 1


def test_settings_of_a_hidden_result_bring_it_back_if_it_is_whole(tiny_cell, monkeypatch):
    assert tiny_cell().status == "ok"
    before = {p.name: p.read_bytes() for p in tiny_cell.folder.iterdir() if p.is_file()}

    def fail():
        with monkeypatch.context() as patch:
            patch.setattr(GaussianSplatting, "step", fails(ValueError("broken")))
            assert tiny_cell("budget.iterations=11", "retry_failed=true").status == "failed"

    fail()
    outcome = tiny_cell()
    assert (outcome.status, outcome.message) == ("kept", "restored: its settings are those of an earlier result")
    assert before == {p.name: p.read_bytes() for p in tiny_cell.folder.iterdir() if p.is_file()}
    fail()
    (model,) = tiny_cell.folder.parent.glob(".*/model.ply")
    model.write_bytes(model.read_bytes()[:-1])
    assert tiny_cell().status == "ok" and statuses(tiny_cell.experiment) == ["ok"]


def spoil_with_folder(path):
    path.unlink()
    path.mkdir()
    (path / "a").touch()


@pytest.mark.parametrize("works", [True, False])
def test_a_broken_record_is_replaced(tiny_cell, monkeypatch, works):
    assert tiny_cell().status == "ok"
    if not works:
        monkeypatch.setattr(GaussianSplatting, "setup", fails(ValueError("broken")))
    for spoil in (spoil_with_folder, lambda path: path.write_bytes(b"\xff\xfe")):
        spoil(tiny_cell.folder / "record.json")
        outcome = tiny_cell("overwrite=always")
        assert outcome.status == ("ok" if works else "failed") and "could not" not in outcome.message
        assert statuses(tiny_cell.experiment) == [outcome.status]


def test_a_failed_replacement_is_finished_before_the_cell_is_looked_up(tiny_cell):
    """A kill between two renames leaves the complete result hidden: it is found and not run again."""
    assert tiny_cell().status == "ok"
    tiny_cell.folder.rename(tiny_cell.folder.with_name(".seed0.part-new"))
    assert tiny_cell().status == "kept" and hidden(tiny_cell.folder) == []
    tiny_cell.folder.rename(tiny_cell.folder.with_name(".seed0.part-old"))
    assert tiny_cell().status == "kept" and hidden(tiny_cell.folder) == []


def test_the_checkpoint_of_a_finished_cell_is_removed(tiny_cell):
    """A kill, or a full disk, between a result and the removal of its checkpoint left the latter for good."""
    assert tiny_cell().status == "ok"
    checkpoint = tiny_cell.experiment / "checkpoints" / f"{short_name(tiny_cell.experiment, tiny_cell.folder)}.pt"
    checkpoint.parent.mkdir(exist_ok=True)
    checkpoint.write_bytes(b"state")
    assert tiny_cell("overwrite=never", "budget.iterations=11").status == "kept" and checkpoint.exists()
    assert tiny_cell().status == "kept" and not checkpoint.exists()


def test_a_failure_beside_a_running_process_removes_nothing_of_its(tiny_cell, monkeypatch):
    def identify(self):
        raise ValueError("broken")

    monkeypatch.setattr(CellRun, "identify", identify)
    tiny_cell.folder.parent.mkdir(parents=True)
    part = tiny_cell.folder.with_name(".seed0.part-1")
    part.mkdir()
    with cell_lock(tiny_cell.experiment, tiny_cell.folder) as acquired:
        assert acquired
        outcome = tiny_cell()
    assert "another process is running the cell" in outcome.message and part.exists()
