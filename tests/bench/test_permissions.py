"""Permissions of results follow the umask, so that colleagues on a cluster can read them."""

from __future__ import annotations

import os
import stat

import pytest

from tdgbench.tables.build import build_tables
from tdgbench.training.checkpoint import Checkpoint
from tests.helpers.cells import run_quietly
from tests.helpers.configs import SMALL, config


class PulledPlugError(BaseException):
    """Not an Exception, so that nothing catches it, like SIGKILL."""


@pytest.mark.parametrize(("umask", "folder", "file"), [(0o022, 0o755, 0o644), (0o027, 0o750, 0o640)])
def test_permissions_follow_the_umask(tmp_path, data_root, monkeypatch, umask, folder, file):
    """A cell that is killed after its first checkpoint, resumed, and tabulated."""
    cfg = config(
        *SMALL, "budget=demo", "budget.iterations=20", "method=tdg", "prior=synthetic", "scene=turntable",
        f"data.root={data_root}", f"results={tmp_path / 'results'}", "checkpoint=0",
    )  # fmt: skip
    experiment, write_if_due = tmp_path / "results" / "single", Checkpoint.write_if_due

    def write_and_die(self, log):
        write_if_due(self, log)
        raise PulledPlugError

    before = os.umask(umask)
    try:
        with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
            patch.setattr(Checkpoint, "write_if_due", write_and_die)
            run_quietly(cfg)
        (checkpoint,) = (experiment / "checkpoints").iterdir()
        assert stat.S_IMODE(checkpoint.stat().st_mode) == file
        assert run_quietly(cfg).message == "resumed after iteration 1"
        build_tables(experiment)
    finally:
        os.umask(before)
    paths = [p for p in (tmp_path / "results").rglob("*") if p.parent.name != "locks"]
    names = {p.name for p in paths}
    assert {
        "seed0",
        "checkpoints",
        "priors",
        "record.json",
        "model.ply",
        "cameras.json",
        "main.csv",
        "main.tex",
    } <= names
    wrong = [p for p in paths if stat.S_IMODE(p.stat().st_mode) != (folder if p.is_dir() else file)]
    assert wrong == []
