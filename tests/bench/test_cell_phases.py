"""The stages of a cell: checkpoints, and the backend that trains."""

import pytest

from tdgbench.bench.backend_check import choose
from tdgbench.cells.folder import hashes_of_content
from tdgbench.cells.record import read_all
from tdgbench.training import checkpoint as checkpoints
from tests.helpers.cells import run_quietly
from tests.helpers.configs import SMALL, config

ITERATIONS = 40


@pytest.fixture
def run(data_root):
    def cell(results, *overrides):
        cfg = config(
            *SMALL, "budget=demo", f"budget.iterations={ITERATIONS}", "prior=synthetic", f"data.root={data_root}",
            f"results={results}", *overrides,
        )  # fmt: skip
        return run_quietly(cfg)

    return cell


class PulledPlugError(BaseException):
    """Not an Exception, so that nothing catches it, like SIGKILL."""


def killed_at(iteration, monkeypatch):
    """Write a checkpoint at every iteration, and die after that of the given one."""
    write_if_due = checkpoints.Checkpoint.write_if_due

    def write_and_die(self, log):
        self._next = 0.0
        write_if_due(self, log)
        if log.iterations == iteration:
            raise PulledPlugError

    monkeypatch.setattr(checkpoints.Checkpoint, "write_if_due", write_and_die)


@pytest.fixture
def auto_is(monkeypatch):
    """What `backend=auto` stands for, as from a new process on: `auto_is("reference", "why")`."""

    def of(backend, line):
        monkeypatch.setattr(choose, "choose", lambda run: choose.AutoBackend(backend, line))
        choose.auto.cache_clear()

    yield of
    choose.auto.cache_clear()


def test_a_killed_cell_resumes(run, tmp_path, monkeypatch):
    assert run(tmp_path / "calm").status == "ok"
    with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
        killed_at(23, patch)
        run(tmp_path / "killed", "checkpoint=0")
    assert len(list((tmp_path / "killed" / "single" / "checkpoints").iterdir())) == 1
    outcome = run(tmp_path / "killed")
    assert (outcome.status, outcome.message) == ("ok", "resumed after iteration 23")
    (calm,), (killed,) = (read_all(tmp_path / name / "single") for name in ("calm", "killed"))
    assert (calm.resumed, killed.resumed) == ([], [23])
    assert (calm.key, calm.scores) == (killed.key, killed.scores)
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


def test_a_verdict_makes_no_finished_cell_run_again(run, tmp_path, auto_is):
    """The key holds the choice `auto`; the record says what trained, and why."""
    few = ("budget.iterations=3", "scene=turntable")
    auto_is("cpu", "the CPU trains, not A: it is wrong")
    assert run(tmp_path / "a", *few).status == "ok"
    auto_is("reference", "A trains: it agrees")
    assert run(tmp_path / "a", *few).status == "kept"
    assert run(tmp_path / "b", *few).status == "ok"
    assert run(tmp_path / "c", "backend=cpu", *few).status == "ok"
    first, second, named = (read_all(tmp_path / name / "single")[0] for name in "abc")
    assert (first.backend, second.backend, named.backend) == ("cpu", "reference", "cpu")
    assert first.key == second.key != named.key
    assert first.notes[-1] == "backend: the CPU trains, not A: it is wrong"
    assert second.notes[-1] == "backend: A trains: it agrees"
    assert not any("backend" in note for note in named.notes)


def test_a_checkpoint_of_another_backend_is_not_used(run, tmp_path, monkeypatch, auto_is):
    few = ("budget.iterations=8", "scene=turntable")
    with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
        killed_at(5, patch)
        run(tmp_path, "checkpoint=0", *few)
    auto_is("reference", "A trains: it agrees")
    assert run(tmp_path, *few).status == "ok"
    (record,) = read_all(tmp_path / "single")
    assert record.resumed == [] and any("not used: other backend (iteration 5)" in note for note in record.notes)
