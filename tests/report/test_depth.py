"""The depth that a report shows is of what the method renders."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tdgbench.bench.colours import expected_depth
from tdgbench.cells.cameras import read_cameras
from tdgbench.cells.record import read_each
from tdgbench.cells.renders import render_model
from tdgbench.report.views import depth_of
from tdgbench.splats.ply import load_ply
from tdgbench.tables.cell import Cell
from tests.helpers.cells import run_quietly
from tests.helpers.configs import QUICK, config


def test_depth_is_seen_from_the_learnt_place_of_the_thermal_camera(tmp_path, data_root):
    cfg = config("method=3dgs", "scene=turntable", *QUICK, "thermal_camera.rig=true", "budget.iterations=40")
    cfg.data.root, cfg.results = str(data_root), str(tmp_path)
    assert run_quietly(cfg).status == "ok"
    ((folder, record),) = read_each(Path(cfg.results) / cfg.name)
    name, camera = next(iter(read_cameras(folder)["test"].items()))
    from_the_given_pose = expected_depth(render_model(load_ply(folder / "model.ply"), camera, depth=True))
    shown = depth_of(Cell(folder, record), name)
    assert shown.shape == from_the_given_pose.shape and not np.array_equal(shown, from_the_given_pose, equal_nan=True)
    assert np.nanmedian(np.abs(shown - from_the_given_pose) / shown) < 0.05
