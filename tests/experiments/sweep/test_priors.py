"""A prior that is not available is one error at the start of a sweep; cells that need none run."""

import shutil
import sys

import pytest

from tdgbench.cells.record import read_all
from tdgbench.experiments.experiment import prepare_prior
from tdgbench.experiments.sweep.plan import unavailable_priors
from tdgbench.priors import PriorUnavailableError
from tests.helpers.command import command_here
from tests.helpers.configs import config

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
