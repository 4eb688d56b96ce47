"""Pictures of a test view are of what the method renders."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.record import read_each
from tdgbench.cells.renders import render_model
from tdgbench.present.colours import expected_depth
from tdgbench.present.view_pictures import rendered_depth
from tests.helpers.cells import run_quietly
from tests.helpers.configs import QUICK, config


def test_depth_is_seen_from_the_learnt_place_of_the_thermal_camera(tmp_path, data_root):
    cfg = config("method=3dgs", "scene=turntable", *QUICK, "thermal_camera.rig=true", "budget.iterations=40")
    cfg.data.root, cfg.results = str(data_root), str(tmp_path)
    assert run_quietly(cfg).status == "ok"
    ((folder, record),) = read_each(Path(cfg.results) / cfg.name)
    cell = CellFolder(folder, record)
    name, camera = next(iter(cell.test_cameras.items()))
    from_the_given_pose = expected_depth(render_model(cell.model("thermal"), camera, depth=True))
    shown = rendered_depth(cell, name)
    assert shown.shape == from_the_given_pose.shape and not np.array_equal(shown, from_the_given_pose, equal_nan=True)
    assert np.nanmedian(np.abs(shown - from_the_given_pose) / shown) < 0.05
