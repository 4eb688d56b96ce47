import shutil

import pytest
from rich.console import Console

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.bench import cell_phases
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import cell_lock, run_cell
from tdgbench.bench.scores import render_views
from tdgbench.cells.folder import CellFolder, hashes_of_content
from tdgbench.cells.paths import cell_folder_of
from tdgbench.cells.record import read_all, read_record
from tdgbench.scenes import view_images
from tdgbench.scenes.formats import decode
from tests.helpers.cells import run_quietly
from tests.helpers.configs import config


def plain_config(scene, tmp_path):
    """The configuration of a cell of a folder of images."""
    return config(
        "budget=demo", "budget.iterations=2", "metrics.lpips.download=false", "dataset=folder", f"data.root={scene}",
        "method=3dgs", f"results={tmp_path / 'results'}",
    )  # fmt: skip


def test_views_that_no_result_holds_are_refused_before_the_training(tiny_cell, monkeypatch):
    monkeypatch.setattr(cell_phases, "MOST_PIXELS", 1000)
    outcome = tiny_cell()
    assert outcome.status == "failed"
    why = "turntable has views of 48×36 px, and results hold 1000 px at most: set data.width=36 or less"
    assert why in outcome.message


@pytest.mark.parametrize("method", ["tdg", "msmg"])
def test_a_cell_writes_all_its_files(small_results, method):
    folder = small_results / "cells" / method / "synthetic" / "turntable" / "colmap" / "seed0"
    record = read_record(folder)
    assert record.status == "ok" and record.split == "eighty_twenty" and record.channels == 1
    assert 5 < record.scores["psnr"] < 60 and 0 < record.scores["depth_abs_rel"] < 1
    assert record.scores["lpips"] is None and "lpips" in record.missing
    assert record.seconds["train"] > 0 and record.peak_rss_mb > 50 and record.train_processor_seconds > 0
    assert 5 < record.train_scores["psnr"] < 60 and 0 < record.train_scores["ssim"] < 1
    assert record.environment["packages"]["torch"] and record.environment["threads"] >= 1
    assert (record.prior is None) == (method != "tdg")
    cell = CellFolder(folder, record)
    assert len(cell.views_with("renders")) == 2 == len(cell.read_views()) and cell.read_log()[-1]["gaussians"] > 0
    assert {name: model.channels for name, model in cell.models().items()} == (
        {"thermal": 1} if method == "tdg" else {"thermal": 1, "rgb": 3}
    )
    assert not [p for p in folder.parent.iterdir() if p.name.startswith(".")]


def test_a_cell_renders_without_the_memory_of_its_training(tiny_cell, monkeypatch):
    moments = []

    def render(trainer, *arguments):
        moments.extend(len(model.state.first) for model in trainer.gaussians.values())
        return render_views(trainer, *arguments)

    monkeypatch.setattr(cell_phases, "render_views", render)
    assert tiny_cell("method=msmg").status == "ok" and moments == [0, 0]


def test_the_data_folder_is_only_read(tiny_cell, data_root):
    before = {p: p.stat().st_mtime_ns for p in data_root.rglob("*")}
    assert tiny_cell("method=tdg").status == "ok" and tiny_cell("scene=facade").status == "ok"
    new = {p.relative_to(data_root).parts[0] for p in set(data_root.rglob("*")) - set(before)}
    assert new <= {"synthetic"}  # where the synthetic scenes are made
    assert list((tiny_cell.experiment.parent / "cache" / "priors").iterdir())


def test_same_cell_same_bytes_and_is_not_run_twice(tiny_cell):
    assert tiny_cell("method=tdg").status == "ok"
    first = read_all(tiny_cell.experiment)[0]
    assert tiny_cell("method=tdg").status == "kept"
    assert tiny_cell("method=tdg", "overwrite=always").status == "ok"
    again = read_all(tiny_cell.experiment)[0]
    assert hashes_of_content(first.hashes) == hashes_of_content(again.hashes)
    assert first.scores == again.scores and first.key == again.key


def test_a_failing_cell_becomes_a_record(tiny_cell, small_scene, tmp_path):
    """A broken image: the record names the stage; the finished result of other settings is hidden, not lost."""
    source = small_scene.train[0].thermal_path.parents[1]
    scene = shutil.copytree(source, tmp_path / "spoiled")
    plain = plain_config(scene, tmp_path)
    progress = CellProgress(Console(quiet=True), 2)
    assert run_cell(plain, "", progress).status == "ok"
    (scene / "thermal" / "view007.png").write_bytes(b"broken")
    outcome = run_cell(plain, "", progress)
    assert outcome.status == "failed" and "view007.png cannot be read" in outcome.message
    records = read_all(tiny_cell.experiment)
    assert [r.status for r in records] == ["failed"]
    assert records[0].failure.phase == "load" and "SceneError" in records[0].failure.traceback
    kept = [p for p in (tiny_cell.experiment / "cells/3dgs/folder/spoiled/colmap").iterdir() if p.name.startswith(".")]
    assert len(kept) == 1 and (kept[0] / "model.ply").exists()
    shutil.copy(source / "thermal" / "view007.png", scene / "thermal" / "view007.png")
    restored = run_cell(plain, "", progress)
    assert restored.status == "kept" and "restored" in restored.message
    assert [r.status for r in read_all(tiny_cell.experiment)] == ["ok"]


def test_non_finite_training_is_recorded(tiny_cell, monkeypatch):
    original = GaussianSplatting.step

    def poisoned(self, iteration):
        if iteration == 7:
            self.model.gaussians.opacity_logits.data[0] = float("nan")
        return original(self, iteration)

    monkeypatch.setattr(GaussianSplatting, "step", poisoned)
    outcome = tiny_cell()
    failure = read_all(tiny_cell.experiment)[0].failure
    assert outcome.status == "failed"
    assert failure.phase == "train" and failure.iteration is not None and failure.iteration >= 7 and failure.tensor


def test_missing_scenes_write_nothing(tiny_cell, tmp_path):
    cfg = config("dataset=rgbt_scenes", f"data.root={tmp_path}", f"results={tmp_path / 'results'}")
    outcome = run_quietly(cfg)
    assert outcome.status == "missing" and "RGBT-Scenes" in outcome.message
    assert not (tiny_cell.experiment / "cells").exists()


def test_a_cell_that_another_process_runs_is_not_run(tiny_cell, tmp_path):
    assert tiny_cell().status == "ok"
    folder = cell_folder_of(tiny_cell.experiment, read_all(tiny_cell.experiment)[0])
    with cell_lock(tiny_cell.experiment, folder) as acquired:
        assert acquired
        assert tiny_cell("overwrite=always").status == "elsewhere"
    assert tiny_cell().status == "kept"


def test_a_failure_is_retried_only_on_request(tiny_cell, monkeypatch):
    tries = []

    def broken(self, iteration):
        tries.append(iteration)
        raise RuntimeError("out of luck")

    with monkeypatch.context() as patch:
        patch.setattr(GaussianSplatting, "step", broken)
        assert tiny_cell().status == "failed"
        again = tiny_cell()
        assert again.status == "failed" and len(tries) == 1
        assert "out of luck (in an earlier run; retry_failed=true runs it again)" in again.message
        assert tiny_cell("retry_failed=true").status == "failed" and len(tries) == 2
    assert tiny_cell().status == "failed"  # nothing that the key covers has changed
    assert tiny_cell("retry_failed=true").status == "ok"


def test_the_outcome_names_what_changed(tiny_cell):
    assert tiny_cell().message == ""
    outcome = tiny_cell("budget.iterations=31")
    assert outcome.status == "ok" and outcome.message == "run again, changed: budget.iterations: 12 → 31"
    kept = tiny_cell("overwrite=never", "seed=0", "budget.sh_degree=0")
    assert kept.status == "kept" and "overwrite=never" in kept.line
    assert "budget.sh_degree: 1 → 0" in kept.message
    assert read_all(tiny_cell.experiment)[0].iterations == 31


def test_a_cell_that_is_kept_decodes_no_image(tiny_cell, small_scene, tmp_path, monkeypatch):
    """But another content of an image makes it run again."""
    scene = shutil.copytree(small_scene.train[0].thermal_path.parents[1], tmp_path / "capture")
    plain = plain_config(scene, tmp_path)
    progress = CellProgress(Console(quiet=True), 2)
    assert run_cell(plain, "", progress).status == "ok"
    decoded = []
    monkeypatch.setattr(view_images, "decode", lambda path, **how: decoded.append(path) or decode(path, **how))
    assert run_cell(plain, "", progress).status == "kept" and decoded == []
    shutil.copy(scene / "thermal" / "view006.png", scene / "thermal" / "view007.png")
    again = run_cell(plain, "", progress)
    assert again.status == "ok" and "the scene's files changed" in again.message and len(decoded) == 10
