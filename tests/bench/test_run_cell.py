import json
import shutil

import numpy as np
import pytest
from rich.console import Console

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.bench import cell_phases
from tdgbench.bench.lock import cell_lock
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import run_cell
from tdgbench.bench.scores import render_views
from tdgbench.cells.folder import hashes_of_content
from tdgbench.cells.paths import cell_folder_of
from tdgbench.cells.record import read_all
from tdgbench.scenes import view_images
from tdgbench.scenes.formats import decode
from tdgbench.splats.ply import load_ply
from tests.helpers.cells import run_quietly
from tests.helpers.configs import SMALL, config


@pytest.fixture
def run(tmp_path, data_root, monkeypatch):
    """Run a small cell into the test's results folder."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))

    def cell(*overrides, variant=""):
        cfg = config(
            *SMALL, "budget=demo", "budget.iterations=30", "prior=synthetic", f"data.root={data_root}",
            f"results={tmp_path / 'results'}", *overrides,
        )  # fmt: skip
        return run_quietly(cfg, variant)

    cell.experiment = tmp_path / "results" / "single"
    return cell


def test_views_that_no_result_holds_are_refused_before_the_training(run, monkeypatch):
    monkeypatch.setattr(cell_phases, "MOST_PIXELS", 1000)
    outcome = run("scene=turntable")
    assert outcome.status == "failed"
    why = "turntable has views of 48×36 px, and results hold 1000 px at most: set data.width=36 or less"
    assert why in outcome.message


@pytest.mark.parametrize("method", ["tdg", "msmg", "3dgs"])
def test_a_cell_writes_all_its_files(run, method):
    assert run(f"method={method}", "scene=turntable").status == "ok"
    folder = run.experiment / "cells" / method / "synthetic" / "turntable" / "colmap" / "seed0"
    record = json.loads((folder / "record.json").read_text())
    assert record["status"] == "ok" and record["split"] == "eighty_twenty" and record["channels"] == 1
    assert 5 < record["scores"]["psnr"] < 60 and 0 < record["scores"]["depth_abs_rel"] < 1
    assert record["scores"]["lpips"] is None and "lpips" in record["missing"]
    assert record["seconds"]["train"] > 0 and record["peak_rss_mb"] > 50
    assert record["train_processor_seconds"] > 0
    assert 5 < record["train_scores"]["psnr"] < 60 and 0 < record["train_scores"]["ssim"] < 1
    assert record["environment"]["packages"]["torch"] and record["environment"]["threads"] >= 1
    assert (record["prior"] is None) == (method != "tdg")
    assert (
        len(list((folder / "renders").glob("*.png"))) == 2 == len((folder / "views.csv").read_text().splitlines()) - 1
    )
    assert load_ply(folder / "model.ply").channels == 1
    assert (folder / "model_rgb.ply").exists() == (method == "msmg")
    assert "gaussians" in (folder / "log.csv").read_text().splitlines()[0]
    assert not [p for p in folder.parent.iterdir() if p.name.startswith(".")]


def test_a_cell_renders_without_the_memory_of_its_training(run, monkeypatch):
    moments = []

    def render(trainer, *arguments):
        moments.extend(len(model.state.first) for model in trainer.gaussians.values())
        return render_views(trainer, *arguments)

    monkeypatch.setattr(cell_phases, "render_views", render)
    assert run("method=msmg", "scene=turntable").status == "ok" and moments == [0, 0]


def test_the_data_folder_is_only_read(run, data_root):
    before = {p: p.stat().st_mtime_ns for p in data_root.rglob("*")}
    assert run("method=tdg").status == "ok" and run("scene=facade").status == "ok"
    new = {p.relative_to(data_root).parts[0] for p in set(data_root.rglob("*")) - set(before)}
    assert new <= {"synthetic"}  # where the synthetic scenes are made
    assert list((run.experiment.parent / "cache" / "priors").iterdir())


def test_same_cell_same_bytes_and_is_not_run_twice(run):
    assert run("method=tdg").status == "ok"
    first = read_all(run.experiment)[0]
    assert run("method=tdg").status == "kept"
    assert run("method=tdg", "overwrite=always").status == "ok"
    again = read_all(run.experiment)[0]
    assert hashes_of_content(first.hashes) == hashes_of_content(again.hashes)
    assert first.scores == again.scores and first.key == again.key


def test_random_points(run):
    assert run("init=random", "init.points.count=200", "method=3dgs").status == "ok"
    record = read_all(run.experiment)[0]
    assert record.init == "random" and record.init_points["points"] == 200
    low, high = np.array(record.init_points["box"])
    assert (high > low).all()


def test_a_failing_cell_becomes_a_record(run, small_scene, tmp_path):
    """A broken image: the record names the stage; the finished result of other settings is hidden, not lost."""
    source = small_scene.train[0].thermal_path.parents[1]
    scene = shutil.copytree(source, tmp_path / "spoiled")
    options = ("dataset=folder", f"data.root={scene}", "method=3dgs")
    strip = [o for o in options if not o.startswith("dataset.loader")]
    plain = config("budget=demo", "budget.iterations=20", "metrics.lpips.download=false",
                   f"results={tmp_path / 'results'}", *strip)  # fmt: skip
    progress = CellProgress(Console(quiet=True), 20)
    assert run_cell(plain, "", progress).status == "ok"
    (scene / "thermal" / "view007.png").write_bytes(b"broken")
    outcome = run_cell(plain, "", progress)
    assert outcome.status == "failed" and "view007.png cannot be read" in outcome.message
    records = read_all(run.experiment)
    assert [r.status for r in records] == ["failed"]
    assert records[0].failure.phase == "load" and "SceneError" in records[0].failure.traceback
    kept = [p for p in (run.experiment / "cells/3dgs/folder/spoiled/colmap").iterdir() if p.name.startswith(".")]
    assert len(kept) == 1 and (kept[0] / "model.ply").exists()
    shutil.copy(source / "thermal" / "view007.png", scene / "thermal" / "view007.png")
    restored = run_cell(plain, "", progress)
    assert restored.status == "kept" and "restored" in restored.message
    assert [r.status for r in read_all(run.experiment)] == ["ok"]


def test_non_finite_training_is_recorded(run, monkeypatch):
    original = GaussianSplatting.step

    def poisoned(self, iteration):
        if iteration == 7:
            self.model.gaussians.opacity_logits.data[0] = float("nan")
        return original(self, iteration)

    monkeypatch.setattr(GaussianSplatting, "step", poisoned)
    outcome = run("method=3dgs")
    failure = read_all(run.experiment)[0].failure
    assert outcome.status == "failed"
    assert failure.phase == "train" and failure.iteration is not None and failure.iteration >= 7 and failure.tensor


def test_missing_scenes_write_nothing(run, tmp_path):
    cfg = config("dataset=rgbt_scenes", f"data.root={tmp_path}", f"results={tmp_path / 'results'}")
    outcome = run_quietly(cfg)
    assert outcome.status == "missing" and "RGBT-Scenes" in outcome.message
    assert not (run.experiment / "cells").exists()


def test_a_cell_that_another_process_runs_is_not_run(run, tmp_path):
    assert run("method=3dgs").status == "ok"
    folder = cell_folder_of(run.experiment, read_all(run.experiment)[0])
    with cell_lock(run.experiment, folder) as acquired:
        assert acquired
        assert run("method=3dgs", "overwrite=always").status == "elsewhere"
    assert run("method=3dgs").status == "kept"


def test_a_failure_is_retried_only_on_request(run, monkeypatch):
    tries = []

    def broken(self, iteration):
        tries.append(iteration)
        raise RuntimeError("out of luck")

    with monkeypatch.context() as patch:
        patch.setattr(GaussianSplatting, "step", broken)
        assert run("method=3dgs").status == "failed"
        again = run("method=3dgs")
        assert again.status == "failed" and len(tries) == 1
        assert "out of luck (in an earlier run; retry_failed=true runs it again)" in again.message
        assert run("method=3dgs", "retry_failed=true").status == "failed" and len(tries) == 2
    assert run("method=3dgs").status == "failed"  # nothing that the key covers has changed
    assert run("method=3dgs", "retry_failed=true").status == "ok"


def test_the_outcome_names_what_changed(run):
    assert run("method=3dgs").message == ""
    outcome = run("method=3dgs", "budget.iterations=31")
    assert outcome.status == "ok" and outcome.message == "run again, changed: budget.iterations: 30 → 31"
    kept = run("method=3dgs", "overwrite=never", "seed=0", "budget.sh_degree=0")
    assert kept.status == "kept" and "overwrite=never" in kept.message
    assert "budget.sh_degree: 1 → 0" in kept.message
    assert read_all(run.experiment)[0].iterations == 31


def test_a_cell_that_is_kept_decodes_no_image(run, small_scene, tmp_path, monkeypatch):
    """But another content of an image makes it run again."""
    scene = shutil.copytree(small_scene.train[0].thermal_path.parents[1], tmp_path / "capture")
    plain = config("budget=demo", "budget.iterations=2", "metrics.lpips.download=false", "dataset=folder",
                   f"data.root={scene}", "method=3dgs", f"results={tmp_path / 'results'}")  # fmt: skip
    progress = CellProgress(Console(quiet=True), 2)
    assert run_cell(plain, "", progress).status == "ok"
    decoded = []
    monkeypatch.setattr(view_images, "decode", lambda path, **how: decoded.append(path) or decode(path, **how))
    assert run_cell(plain, "", progress).status == "kept" and decoded == []
    shutil.copy(scene / "thermal" / "view006.png", scene / "thermal" / "view007.png")
    again = run_cell(plain, "", progress)
    assert again.status == "ok" and "the scene's files changed" in again.message and len(decoded) == 10
