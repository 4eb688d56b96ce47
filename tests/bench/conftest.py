"""A tiny cell, to see what becomes of failures."""

from __future__ import annotations

import pytest
from omegaconf import OmegaConf

from tests.helpers.cells import run_quietly
from tests.helpers.configs import QUICK, config


@pytest.fixture
def tiny_cell(tmp_path, data_root):
    """Run a tiny cell into the test's results folder: `tiny_cell(*overrides, variant=…, **settings)`."""

    def of(*overrides, variant="", **settings):
        options = ("method=3dgs", "scene=turntable", f"data.root={data_root}", f"results={tmp_path / 'results'}")
        cfg = config(*QUICK, *options, *overrides)
        OmegaConf.set_struct(cfg, False)
        for key, value in settings.items():
            OmegaConf.update(cfg, key.replace("__", "."), value)
        return run_quietly(cfg, variant)

    of.experiment = tmp_path / "results" / "single"
    of.folder = of.experiment / "cells" / "3dgs" / "synthetic" / "turntable" / "colmap" / "seed0"
    return of
