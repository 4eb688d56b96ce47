"""Cells of a method on a small gray scene, `small_gray_scene`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tdgbench.cells.record import Record, read_each
from tests.helpers.cells import run_quietly
from tests.helpers.configs import QUICK, config


@pytest.fixture
def run(tmp_path, data_root) -> Callable[..., tuple[Path, Record]]:
    """Return a function that runs a method's cell, with options of its file, and returns folder and record."""

    def run(method: str, *overrides: str, status="ok", **options) -> tuple[Path, Record]:
        cfg = config(f"method={method}", "scene=turntable", *QUICK, *overrides)
        cfg.data.root, cfg.results = str(data_root), str(tmp_path / "results")
        for name, value in options.items():
            cfg.method[name] = str(value)
        outcome = run_quietly(cfg)
        assert outcome.status == status, outcome.message
        return {r.method: (f, r) for f, r in read_each(tmp_path / "results/single")}[cfg.method.name]

    return run
