"""What a sweep says where there is no terminal: its cells, what each of them scored, and the time left."""

from __future__ import annotations

import re
import shutil
import sys

import pytest

from tdgbench.cells.record import read_all
from tdgbench.experiments.experiment import prepare_prior
from tdgbench.experiments.sweep.plan import unavailable_priors
from tdgbench.priors import PriorUnavailableError
from tests.helpers.command import command_here
from tests.helpers.configs import QUICK, config


def test_a_sweep_talks_without_a_terminal(tmp_path, data_root):
    sweep = ("-m", *QUICK, f"data.root={data_root}", "method=3dgs", "scene=turntable")
    first = command_here(tmp_path, *sweep, "seed=1,2", "threads=3")
    assert first.returncode == 0, first.stderr[-3000:]
    assert [one.environment["threads"] for one in read_all(tmp_path / "results" / "single")] == [3, 3]
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
    """A folder of captures with an odd name; a sweep with a misspelt one runs nothing."""
    root = tmp_path / "captures"
    root.mkdir()
    (root / "1.10").symlink_to(small_scene.train[0].thermal_path.parents[1])
    sweep = ("dataset=folder", f"data.root={root}", "scene='1.10',absent", "method=3dgs", "budget=demo",
             "budget.iterations=3", "metrics.lpips.download=false")  # fmt: skip
    run = command_here(tmp_path, "-m", *sweep)
    assert run.returncode == 1 and run.stderr == f"error: absent not found in {root}; scenes there: 1.10\n"
    assert not [*tmp_path.glob("results/*/tables")]
    run = command_here(tmp_path, *sweep[:2], "scene='1.10'", *sweep[3:])
    assert run.returncode == 0, run.stderr[-3000:]


FAST = ("budget=demo", "budget.iterations=8", "metrics.lpips.download=false")


@pytest.fixture
def no_packages(monkeypatch):
    for name in ("transformers", "diffusers"):
        monkeypatch.setitem(sys.modules, name, None)


def test_only_methods_with_a_prior_need_it(no_packages):
    prepare_prior(config("dataset=folder", "method=msmg"))
    prepare_prior(config("dataset=folder", "method=tdg", "prior=sfm_points"))
    with pytest.raises(PriorUnavailableError, match="prior=marigold is not available"):
        prepare_prior(config("dataset=folder", "method=tdg"))


def test_each_missing_prior_is_named_once(no_packages):
    methods = [config("dataset=paper", f"method={name}") for name in ("tdg", "msmg", "tdg_released")]
    wrong = config("dataset=paper", "method=tdg", "seed=-1")
    other = config("dataset=paper", "method=tdg", "prior=onnx")
    first, second = unavailable_priors([*methods, wrong, other])
    assert first.startswith("prior=marigold") and second.startswith("prior=onnx")


def test_table_1_without_the_paper_s_prior(tmp_path, small_scene, no_packages):
    root = tmp_path / "data" / "RGBT-Scenes"
    for name in ("RoadBlock", "Truck"):
        shutil.copytree(small_scene.train[0].thermal_path.parents[1], root / name)
    words = ("+experiment=table1", "scene=RoadBlock,Truck", "method=3dgs,tdg", f"data.root={tmp_path / 'data'}", *FAST)
    run = command_here(tmp_path, *words)
    assert run.returncode == 1 and "Traceback" not in run.stderr
    assert run.stderr.count("prior=marigold is not available") == 1
    start = run.stderr.split("splat on", 1)[0]  # before the first cell
    assert "error: prior=marigold is not available" in start and "pip install -e '.[depth]'" in start
    for other in ("prior=depth_anything", "prior=onnx", "prior=files", "prior=sfm_points"):
        assert other in start
    assert "2 cells run, 0 already there, 2 failed, 0 without data" in run.stdout
    ends = [line for line in run.stdout.splitlines() if line.startswith("failed:")]
    assert len(ends) == 1 and ends[0].startswith("failed: 2 cells without a depth prior: prior: prior=marigold is not")
    records = {(r.method, r.scene): r for r in read_all(tmp_path / "results" / "table1")}
    assert {key: r.status for key, r in records.items()} == {
        (m, s): "ok" if m == "3dgs" else "failed" for m in ("3dgs", "tdg") for s in ("RoadBlock", "Truck")
    }
    assert "failed in prior: PriorUnavailableError: prior=marigold is not" in records["tdg", "Truck"].why_failed


@pytest.mark.slow
def test_a_failure_for_want_of_a_prior_is_tried_again(tmp_path, data_root, small_scene, monkeypatch):
    words = ("method=tdg", "scene=orbit", f"data.root={data_root}", "prior=onnx", f"prior.estimator.model={tmp_path}/a",
             "dataset.loader.width=48", "dataset.loader.height=36", "dataset.loader.views=10",
             "dataset.loader.points=300", *FAST)  # fmt: skip
    for _ in range(2):
        run = command_here(tmp_path, *words)
        assert run.returncode == 1 and f"{tmp_path}/a cannot be used: No such file" in run.stderr
        assert "in an earlier run" not in run.stdout


def test_experiments_whose_cells_all_need_the_prior_end_at_once(tmp_path, arco_folder, no_packages):
    for words in (("+experiment=skips",), ("+experiment=error_time",)):
        run = command_here(tmp_path, *words, "dataset=folder", f"data.root={arco_folder}", "study.scenes=[null]")
        assert run.returncode == 1 and run.stderr.startswith("error: prior=marigold is not available"), run.stderr
        assert run.stdout == ""
