"""Permissions of results follow the umask, so that colleagues on a cluster can read them."""

from __future__ import annotations

import os
import stat

import pytest

from tdgbench.tables.build import build_tables
from tests.helpers.cells import PulledPlugError, killed_at, run_quietly
from tests.helpers.configs import QUICK, config


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
