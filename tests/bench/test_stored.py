"""No stale result stands for a failure, and nothing finished is lost."""

import errno

import pytest

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.bench import run_cell
from tdgbench.bench.cell_phases import CellRun
from tdgbench.bench.run_cell import cell_lock
from tdgbench.cells.paths import short_name
from tests.helpers.cells import fails, hidden, statuses


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
        patch.setattr(run_cell.Record, "write", full)
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
