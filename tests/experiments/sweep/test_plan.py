"""What a sweep says where there is no terminal: its cells, what each of them scored, and the time left."""

from __future__ import annotations

import re

from tests.helpers.command import command_here
from tests.helpers.configs import QUICK


def test_a_sweep_talks_without_a_terminal(tmp_path, data_root):
    sweep = ("-m", *QUICK, f"data.root={data_root}", "method=3dgs", "scene=turntable")
    first = command_here(tmp_path, *sweep, "seed=1,2")
    assert first.returncode == 0, first.stderr[-3000:]
    assert "single: 2 cells, 0 of them without data\n" in first.stderr
    title = "3dgs on synthetic/turntable, colmap, seed 1"
    assert re.search(rf"^{title}: starts, at most 12 iterations on 8 training views$", first.stderr, re.MULTILINE)
    scores = r"PSNR \d+\.\d\d dB, SSIM 0\.\d{3}, LPIPS n/a, trained in 0:00:\d\d"
    assert re.search(rf"^{title}: done, {scores}$", first.stderr, re.MULTILINE)
    left = r"1 of 2 cells to go, about 0:\d\d:\d\d left \(until \w+ \d\d:\d\d\)"
    assert re.search(rf"^single: {left}$", first.stderr, re.MULTILINE)
    assert not re.search(r"\x1b|\r", first.stderr + first.stdout)

    again = command_here(tmp_path, *sweep, "seed=0,1,2")
    assert "single: 3 cells, 0 of them without data\n" in again.stderr
    assert again.stderr.count(": starts, ") == 1 and again.stderr.count(": already there\n") == 2


def test_a_sweep_over_data_sets(tmp_path, data_root):
    """Two that results call alike have a cell each, like two that they do not."""
    sweep = ("-m", *QUICK, f"data.root={data_root}", "method=3dgs", "scene=turntable", "hydra/launcher=basic")
    for others, folders in (
        ("synthetic,synthetic_degC", ["synthetic/turntable/colmap/seed0", "synthetic_degC/turntable/colmap/seed0"]),
        ("synthetic_degC,synthetic_gradient", [f"synthetic_degC/turntable/colmap/seed0,dataset={name}"
                                               for name in ("synthetic_degC", "synthetic_gradient")]),
    ):  # fmt: skip
        run = command_here(tmp_path, *sweep, f"dataset={others}", f"name={others[-4:]}")
        assert run.returncode == 0, run.stderr[-3000:]
        assert "2 cells, 0 of them without data\n" in run.stderr
        cells = tmp_path / "results" / others[-4:] / "cells" / "3dgs"
        assert sorted(path.parent.relative_to(cells).as_posix() for path in cells.rglob("record.json")) == folders
    run = command_here(tmp_path, *sweep, "data.split=eighty_twenty,nosuch", "name=wrong")
    assert run.returncode == 1 and "2 cells, 0 of them without data\n" in run.stderr and "1 cell run" in run.stdout
    run = command_here(tmp_path, "-m", "dataset=rgbt_scenes,thermalmix", "scene=Truck", f"data.root={data_root}")
    assert run.returncode == 1 and "Truck is a scene of RGBT-Scenes: use dataset=rgbt_scenes" in run.stderr


def test_names_in_quotes_and_scenes_that_are_missing(tmp_path, small_scene):
    """A folder of captures with an odd name; one scene of two is not there."""
    root = tmp_path / "captures"
    root.mkdir()
    (root / "1.10").symlink_to(small_scene.train[0].thermal_path.parents[1])
    sweep = ("dataset=folder", f"data.root={root}", "scene='1.10',absent", "method=3dgs", "budget=demo",
             "budget.iterations=3", "metrics.lpips.download=false")  # fmt: skip
    run = command_here(tmp_path, "-m", *sweep)
    assert run.returncode == 1, run.stderr[-3000:]
    assert "single: 2 cells, 1 of them without data\n" in run.stderr
