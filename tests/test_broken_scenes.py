"""Broken scenes among good ones: the good cells finish, and each broken scene is one clear error."""

from __future__ import annotations

import os
import shutil

from tdgbench.cells.record import read_all
from tests.helpers.command import command_here
from tests.helpers.configs import SMALL
from tests.helpers.models import put

OPTIONS = [o for o in SMALL if not o.startswith("dataset.loader")]


def test_good_cells_finish_and_the_others_say_why(tmp_path, small_scene):
    source, root = small_scene.train[0].thermal_path.parents[1], tmp_path / "data"
    for name in ("1", "corrupt", "cut", "pipe", "thermal_only", "twisted", "unposed"):
        shutil.copytree(source, root / name)
    (root / "corrupt" / "thermal" / "view003.png").write_bytes(b"\x89PNG, and then nothing")
    shutil.rmtree(root / "unposed" / "sparse")
    shutil.rmtree(root / "thermal_only" / "rgb")
    points = root / "cut" / "sparse" / "0" / "points3D.bin"
    points.write_bytes(points.read_bytes()[:-1])
    (root / "pipe" / "temperature.json").unlink()
    os.mkfifo(root / "pipe" / "temperature.json")
    put(root / "twisted" / "sparse" / "0" / "images.bin", 12, "<4d", 0, 0, 0, 0)
    run = command_here(
        tmp_path, "-m", *OPTIONS, "dataset=folder", f"data.root={root}", "budget=demo", "budget.iterations=12",
        "method=msmg", "scene=1,corrupt,cut,pipe,thermal_only,twisted,unposed",
    )  # fmt: skip
    assert run.returncode == 1 and "Traceback" not in run.stderr
    assert "1 cell run, 0 already there, 6 failed" in run.stdout
    said = [line for line in run.stdout.splitlines() if line.startswith("failed:")]
    assert len(said) == 6
    for scene, what in (
        ("corrupt", "view003.png cannot be read as an image"),
        ("cut", "points3D.bin is damaged: the file counts"),
        ("pipe", "temperature.json is a FIFO, not a file"),
        ("thermal_only", "has no RGB image; a method that trains on RGB cannot use this scene"),
        ("twisted", "images.bin is damaged: the quaternion of image 'view000.png' has length 0; it must be 1"),
        ("unposed", "has no COLMAP model in sparse/0; find poses first: tdgbench data prepare does"),
    ):
        (line,) = (line for line in said if f"folder/{scene}," in line)
        assert what in line
    records = {r.scene: r for r in read_all(tmp_path / "results" / "single")}
    assert {name for name, r in records.items() if r.status == "ok"} == {"1"} and len(records) == 7
    assert "failed in" in (tmp_path / "results" / "single" / "tables" / "main.csv").read_text()
    assert "view003.png" in (tmp_path / "results" / "single" / "report.html").read_text()
