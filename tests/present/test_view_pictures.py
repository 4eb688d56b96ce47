"""Pictures of a test view are of what the method renders."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.record import read_each
from tdgbench.cells.renders import render_model
from tdgbench.present.colours import colored, expected_depth
from tdgbench.present.html import embedded
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


def test_colours_span_the_range_and_gray_marks_what_is_not_known():
    pixels = colored(np.array([[0.0, 1.0, np.nan]]), "inferno", 0, 1)
    assert pixels[0, 0].sum() < 20 < pixels[0, 1].sum() and (pixels[0, 2] == 128).all()
    assert embedded(pixels).startswith("data:image/png;base64,")
