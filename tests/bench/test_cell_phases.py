"""The stages of a cell: checkpoints, and the backend that trains."""

from __future__ import annotations

import os
import stat

import pytest

from tdgbench.bench import run_cell
from tdgbench.bench.backend_check import choose
from tdgbench.cells.folder import hashes_of_content
from tdgbench.cells.record import read_all
from tdgbench.tables.build import build_tables
from tests.helpers.cells import PulledPlugError, killed_at, run_quietly
from tests.helpers.configs import QUICK, config

FEW = (*QUICK, "budget.iterations=8", "method=3dgs", "scene=turntable")


@pytest.fixture
def run(data_root):
    def cell(results, *overrides):
        return run_quietly(config(*FEW, f"data.root={data_root}", f"results={results}", *overrides))

    return cell


@pytest.fixture
def auto_is(monkeypatch):
    """What `backend=auto` stands for, as from a new process on: `auto_is("reference", "why")`."""

    def of(backend, line):
        monkeypatch.setattr(choose, "choose", lambda run: choose.AutoBackend(backend, line))
        choose.auto.cache_clear()

    yield of
    choose.auto.cache_clear()


def test_a_killed_cell_resumes(run, tmp_path, monkeypatch):
    longer = ("method=tdg", "budget.iterations=40", "prior.estimator.noise=50")
    assert run(tmp_path / "calm", *longer).status == "ok"
    with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
        killed_at(23, patch)
        run(tmp_path / "killed", "checkpoint=0", *longer)
    assert len(list((tmp_path / "killed" / "single" / "checkpoints").iterdir())) == 1
    outcome = run(tmp_path / "killed", *longer)
    assert (outcome.status, outcome.message) == ("ok", "resumed after iteration 23")
    (calm,), (killed,) = (read_all(tmp_path / name / "single") for name in ("calm", "killed"))
    assert (calm.resumed, killed.resumed) == ([], [23])
    assert (calm.key, calm.scores) == (killed.key, killed.scores)
    assert calm.doubts == killed.doubts and "a rank correlation of" in calm.doubts[0]
    assert hashes_of_content(calm.hashes) == hashes_of_content(killed.hashes)
    assert not list((tmp_path / "killed" / "single" / "checkpoints").iterdir())


@pytest.mark.parametrize(
    ("change", "noted"), [("overwrite=always", False), ("method.method.lambda_ssim=0.3", True)]
)  # fmt: skip
def test_a_checkpoint_of_other_settings_is_not_used(run, tmp_path, monkeypatch, change, noted):
    with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
        killed_at(5, patch)
        run(tmp_path, "checkpoint=0")
    assert run(tmp_path, change).status == "ok"
    (record,) = read_all(tmp_path / "single")
    assert record.resumed == []
    assert any("not used: other settings, data or code" in note for note in record.notes) == noted


@pytest.mark.parametrize("changed", ["python", "packages", "platform", "cpu", "simd_lanes", "gpu", "backend"])
def test_a_checkpoint_of_another_machine_or_software_is_not_used(run, tmp_path, monkeypatch, auto_is, changed):
    auto_is("cpu", "")
    with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
        killed_at(5, patch)
        run(tmp_path, "checkpoint=0")
    described = run_cell.describe_environment
    if changed == "backend":
        auto_is("reference", "")
    else:
        monkeypatch.setattr(run_cell, "describe_environment", lambda *given: {**described(*given), changed: {}})
    assert run(tmp_path).status == "ok"
    (record,) = read_all(tmp_path / "single")
    assert record.resumed == [] and any(f"not used: other {changed}" in note for note in record.notes)


def test_no_interval_writes_no_checkpoint(run, tmp_path, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
        killed_at(5, patch)
        run(tmp_path, "checkpoint=null")
    assert not list(tmp_path.rglob("*.pt"))


def test_a_verdict_makes_no_finished_cell_run_again(run, tmp_path, auto_is):
    """The key holds the choice `auto`; the record says what trained, and why."""
    auto_is("cpu", "the CPU trains, not A: it is wrong")
    assert run(tmp_path / "a").status == "ok"
    auto_is("reference", "A trains: it agrees")
    assert run(tmp_path / "a").status == "kept"
    assert run(tmp_path / "b").status == "ok"
    assert run(tmp_path / "c", "backend=cpu").status == "ok"
    first, second, named = (read_all(tmp_path / name / "single")[0] for name in "abc")
    assert (first.backend, second.backend, named.backend) == ("cpu", "reference", "cpu")
    assert first.key == second.key != named.key
    assert first.notes[-1] == "backend: the CPU trains, not A: it is wrong"
    assert second.notes[-1] == "backend: A trains: it agrees"
    assert not any("backend" in note for note in named.notes)


@pytest.mark.parametrize(("umask", "folder", "file"), [(0o022, 0o755, 0o644), (0o027, 0o750, 0o640)])
def test_permissions_follow_the_umask(tmp_path, data_root, monkeypatch, umask, folder, file):
    """A cell that is killed after its first checkpoint, resumed, and tabulated."""
    place = f"data.root={data_root}", f"results={tmp_path / 'results'}"
    cfg = config(*QUICK, "method=tdg", "scene=turntable", *place, "checkpoint=0")
    experiment = tmp_path / "results" / "single"
    before = os.umask(umask)
    try:
        with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
            killed_at(1, patch)
            run_quietly(cfg)
        (checkpoint,) = (experiment / "checkpoints").iterdir()
        assert stat.S_IMODE(checkpoint.stat().st_mode) == file
        assert run_quietly(cfg).message == "resumed after iteration 1"
        build_tables(experiment)
    finally:
        os.umask(before)
    paths = [p for p in (tmp_path / "results").rglob("*") if p.parent.name != "locks"]
    names = {p.name for p in paths}
    files = {"record.json", "model.ply", "cameras.json", "main.csv", "main.tex"}
    assert {"seed0", "checkpoints", "priors", *files} <= names
    wrong = [p for p in paths if stat.S_IMODE(p.stat().st_mode) != (folder if p.is_dir() else file)]
    assert wrong == []
