"""A cell trained over the mean of its training images is told, verified and shown over it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tdgbench.cells.read_files import read_picture
from tdgbench.scoring import to_8bit
from tdgbench.verify import verify_cell
from tdgbench.view.cells import open_cell
from tdgbench.view.renderer import Renderer
from tests.helpers.cells import run_quietly
from tests.helpers.configs import SMALL, config


@pytest.fixture(scope="module")
def cell(tmp_path_factory, data_root):
    results = tmp_path_factory.mktemp("results")
    words = (*SMALL, "method=msmg", "scene=turntable", "budget=demo", "budget.iterations=20", "budget.background=mean")
    cfg = config(*words, f"data.root={data_root}", f"results={results}")
    assert run_quietly(cfg).status == "ok"
    return next(results.rglob("record.json")).parent


def test_the_record_has_it(cell):
    parts = json.loads((cell / "record.json").read_text())["parts"]
    background = {name: report["background"] for name, report in parts.items() if "background" in report}
    assert {name: len(color) for name, color in background.items()} == {"thermal": 1, "rgb": 3}
    assert all(0.05 < value < 0.95 for color in background.values() for value in color)


def test_the_cell_is_verified_over_it(cell, tmp_path):
    assert verify_cell(cell) == []
    changed = Path(shutil.copytree(cell, tmp_path / "cell"))
    record = json.loads((changed / "record.json").read_text())
    record["parts"]["thermal"]["background"] = [0.5, 0.5]
    (changed / "record.json").write_text(json.dumps(record))
    assert any("background has the shape (2,)" in problem for problem in verify_cell(changed))


def test_the_viewer_shows_it(cell):
    shown, stored = pictures(open_cell(cell))
    assert np.abs(shown.astype(int) - stored).max() <= 1


def pictures(viewed) -> tuple[np.ndarray, np.ndarray]:
    """A test view as the viewer renders it, and as the cell stored it."""
    name, camera = next(iter(viewed.test.items()))
    shown = to_8bit(Renderer({"": viewed}).values("", "thermal", camera))
    return shown, read_picture(viewed.cell.folder / "renders" / f"{name}.png", (camera.width, camera.height))
