"""Whatever fails in a cell is an outcome and, where it can be written, a record; no stale result stands for it."""

import errno
import json
import os
import shutil

import pytest
import torch
from omegaconf import OmegaConf
from rich.console import Console

from methods.splat import Splat
from tdgbench.bench import cell
from tdgbench.bench.cell import run_cell
from tdgbench.bench.lock import cell_lock
from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all, schema_problems
from tdgbench.bench.run import CellRun
from tdgbench.training.checkpoint import Checkpoint
from tests.helpers.configs import QUICK, config


@pytest.fixture
def run(tmp_path, data_root):
    """Run a tiny cell into the test's results folder."""

    def of(*overrides, variant="", **settings):
        options = ("method=splat", "scene=turntable", f"data.root={data_root}", f"results={tmp_path / 'results'}")
        cfg = config(*QUICK, *options, *overrides)
        OmegaConf.set_struct(cfg, False)
        for key, value in settings.items():
            OmegaConf.update(cfg, key.replace("__", "."), value)
        return run_cell(cfg, variant, CellProgress(Console(quiet=True), 12))

    of.experiment = tmp_path / "results" / "single"
    of.folder = of.experiment / "cells" / "splat" / "synthetic" / "turntable" / "colmap" / "seed0"
    return of


def statuses(experiment) -> list[str]:
    return [record.status for record in read_all(experiment)]


def hidden(folder) -> list[str]:
    return sorted(path.name for path in folder.parent.iterdir() if path.name.startswith("."))


def fails(error):
    """A `Splat.step` that raises an error."""

    def step(self, iteration):
        raise error

    return step


def test_no_stale_result_stands_for_a_failure(run, monkeypatch):
    """Good, broken, good, broken: the failure is what the tables see each time."""
    for _ in range(3):
        assert run("overwrite=always").status == "ok" and statuses(run.experiment) == ["ok"]
        with monkeypatch.context() as patch:
            patch.setattr(Splat, "step", fails(ValueError("broken")))
            outcome = run("overwrite=always")
        assert outcome.status == "failed" and "could not be written" not in outcome.message
        assert statuses(run.experiment) == ["failed"]
        assert len(hidden(run.folder)) == 1
        assert [path.name for path in run.folder.iterdir()] == ["record.json"]


def test_no_stale_result_stands_where_the_record_of_a_failure_cannot_be_written(run, monkeypatch):
    assert run().status == "ok"

    def full(self, folder):
        raise OSError(errno.ENOSPC, "full")

    with monkeypatch.context() as patch:
        patch.setattr(Splat, "step", fails(ValueError("broken")))
        patch.setattr(cell.Record, "write", full)
        outcome = run("budget.iterations=11")
    assert outcome.status == "failed" and "its record could not be written" in outcome.message
    assert statuses(run.experiment) == [] and len(hidden(run.folder)) == 1


def test_settings_of_a_hidden_result_bring_it_back_if_it_is_whole(run, monkeypatch):
    assert run().status == "ok"
    before = {p.name: p.read_bytes() for p in run.folder.iterdir() if p.is_file()}

    def fail():
        with monkeypatch.context() as patch:
            patch.setattr(Splat, "step", fails(ValueError("broken")))
            assert run("budget.iterations=11", "retry_failed=true").status == "failed"

    fail()
    outcome = run()
    assert (outcome.status, outcome.message) == ("kept", "restored: its settings are those of an earlier result")
    assert before == {p.name: p.read_bytes() for p in run.folder.iterdir() if p.is_file()}
    fail()
    (model,) = run.folder.parent.glob(".*/model.ply")
    model.write_bytes(model.read_bytes()[:-1])
    assert run().status == "ok" and statuses(run.experiment) == ["ok"]


@pytest.mark.parametrize("value", [float("inf"), float("nan"), float("-inf")])
def test_settings_that_are_not_finite_leave_a_record(run, value):
    outcome = run(budget__iterations=value)
    assert outcome.status == "failed"
    (record,) = read_all(run.experiment)
    assert record.failure is not None
    assert schema_problems((run.folder / "record.json").read_text()) == []


def test_a_failure_that_is_no_json_leaves_a_record(run, monkeypatch):
    def note(self, _):
        self.record.init_points = {"box": [float("nan"), object()]}

    monkeypatch.setattr(Splat, "setup", fails(ValueError("lone surrogate \udcff, NUL \0")))
    monkeypatch.setattr(CellRun, "note_points", note)
    assert run().status == "failed"
    (record,) = read_all(run.experiment)
    assert record.status == "failed" and record.init_points["box"][0] == "nan"


@pytest.mark.parametrize("option", ["seed=abc", "seed=1.5", "seed=null", "seed=true"])
def test_options_that_name_no_cell_fail_without_a_record(run, option):
    outcome = run(option)
    assert outcome.status == "failed" and "seed is" in outcome.message and "splat on turntable" in outcome.title
    assert not (run.experiment / "cells").exists()


@pytest.mark.parametrize("threads", [0, -1])
def test_threads_below_one_fail_their_cell_only(run, threads):
    outcome = run(f"threads={threads}", variant=f"threads={threads}")
    assert outcome.status == "failed" and "thread" in outcome.message
    (record,) = read_all(run.experiment)
    assert (record.status, record.dataset, record.failure.stage) == ("failed", "synthetic", "options")


def recursion(self, iteration):
    return recursion(self, iteration)


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (fails(SystemExit(3)), "its code ended the process with status 3"),
        (fails(MemoryError()), "smaller images (data.width=…)"),
        (recursion, "RecursionError"),
    ],
)
def test_what_is_hardly_an_error_fails_the_cell(run, monkeypatch, step, said):
    monkeypatch.setattr(Splat, "step", step)
    outcome = run()
    assert outcome.status == "failed" and said in outcome.message
    assert said in read_all(run.experiment)[0].failure.error


def test_an_unreadable_machine_fails_the_cell(run, monkeypatch):
    def broken():
        raise ValueError("no such processor")

    monkeypatch.setattr(cell, "describe_environment", broken)
    assert "no such processor" in run().message
    assert statuses(run.experiment) == ["failed"]


def test_ctrl_c_passes_and_releases_the_lock(run, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Splat, "step", fails(KeyboardInterrupt()))
        with pytest.raises(KeyboardInterrupt):
            run()
    assert not (run.experiment / "cells").exists()
    with cell_lock(run.experiment, run.folder) as acquired:
        assert acquired
    assert run().status == "ok"


ENVIRONMENT = [
    OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)),
    OSError(errno.EROFS, os.strerror(errno.EROFS), "a.png"),
    OSError(errno.EMFILE, os.strerror(errno.EMFILE), "a.png"),
    MemoryError("Unable to allocate"),
    torch.OutOfMemoryError("CUDA out of memory"),
    RuntimeError("CUDA error: device-side assert triggered"),
]


@pytest.mark.parametrize("error", ENVIRONMENT, ids=lambda error: str(error)[:20])
def test_a_failure_of_the_environment_is_tried_again(run, monkeypatch, error):
    with monkeypatch.context() as patch:
        patch.setattr(Splat, "step", fails(error))
        assert run().status == "failed"
    (record,) = read_all(run.experiment)
    assert record.failure.of_environment and schema_problems((run.folder / "record.json").read_text()) == []
    assert run().status == "ok"


def test_a_failure_of_the_environment_hides_no_result_of_the_same_settings(run, monkeypatch):
    assert run().status == "ok"
    with monkeypatch.context() as patch:
        patch.setattr(Splat, "step", fails(MemoryError()))
        assert run("overwrite=always").status == "failed"
    assert statuses(run.experiment) == ["ok"] and run().status == "kept"


def test_clearing_up_changes_no_outcome(run, monkeypatch):
    def broken(*_):
        raise OSError(errno.EIO, "Input/output error", "checkpoint.pt")

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "discard", broken)
        patch.setattr(CellRun, "close", broken)
        patch.setattr(CellProgress, "end", broken)
        outcome = run()
    assert outcome.status == "ok"
    assert "its checkpoint could not be removed" in outcome.message and "clearing up" in outcome.message
    assert statuses(run.experiment) == ["ok"] and run().status == "kept"


def spoil_with_folder(path):
    path.unlink()
    path.mkdir()
    (path / "a").touch()


def spoil_with_fifo(path):
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(b"\xff\xfe"),
        lambda path: path.write_text("[" * 100_000),
        lambda path: path.write_text("[1]"),
        lambda path: path.write_text(path.read_text().replace('"ok"', '"fine"')),
        lambda path: path.write_text(path.read_text().replace('"schema": 1', '"schema": 7')),
        spoil_with_folder,
        spoil_with_fifo,
    ],
    ids=["bytes", "deep", "list", "status", "schema", "folder", "fifo"],
)
@pytest.mark.parametrize("works", [True, False])
def test_a_broken_record_is_replaced(run, monkeypatch, spoil, works):
    assert run().status == "ok"
    spoil(run.folder / "record.json")
    if not works:
        monkeypatch.setattr(Splat, "setup", fails(ValueError("broken")))
    outcome = run()
    assert outcome.status == ("ok" if works else "failed") and "could not" not in outcome.message
    assert statuses(run.experiment) == [outcome.status]


def test_a_failed_replacement_is_finished_before_the_cell_is_looked_up(run):
    """A kill between two renames leaves the complete result hidden: it is found and not run again."""
    assert run().status == "ok"
    run.folder.rename(run.folder.with_name(".seed0.part-new"))
    assert run().status == "kept" and hidden(run.folder) == []
    run.folder.rename(run.folder.with_name(".seed0.part-old"))
    assert run().status == "kept" and hidden(run.folder) == []


def test_a_failure_beside_a_running_process_removes_nothing_of_its(run, monkeypatch):
    def load(self):
        raise ValueError("broken")

    monkeypatch.setattr(CellRun, "load", load)
    run.folder.parent.mkdir(parents=True)
    part = run.folder.with_name(".seed0.part-1")
    part.mkdir()
    with cell_lock(run.experiment, run.folder) as acquired:
        assert acquired
        outcome = run()
    assert "another process is running the cell" in outcome.message and part.exists()


@pytest.mark.parametrize("junk", ["locks", "lock"])
def test_damaged_locks_fail_with_their_name(run, junk):
    assert run().status == "ok"
    locks = run.experiment / "locks"
    if junk == "locks":
        shutil.rmtree(locks)
        locks.touch()
    else:
        (lock,) = locks.iterdir()
        lock.unlink()
        lock.mkdir()
    outcome = run()
    assert outcome.status == "failed" and str(locks) in outcome.message and "remove" in outcome.message
    assert statuses(run.experiment) == ["ok"]


def test_priors_are_estimated_without_a_cache(run):
    cache = run.experiment.parent / "cache"
    cache.parent.mkdir(parents=True)
    cache.touch()
    outcome = run("method=tdg")
    assert outcome.status == "ok" and "depth priors were not cached" in outcome.message


def test_old_records_of_failures_are_read(run, monkeypatch):
    monkeypatch.setattr(Splat, "setup", fails(ValueError("broken")))
    assert run().status == "failed"
    path = run.folder / "record.json"
    content = json.loads(path.read_text())
    del content["failure"]["of_environment"]
    path.write_text(json.dumps(content))
    assert schema_problems(path.read_text()) == [] and "in an earlier run" in run().message
    assert cell_folder_of(run.experiment, read_all(run.experiment)[0]) == run.folder
