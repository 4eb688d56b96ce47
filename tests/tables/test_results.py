"""Results in which something cannot be read: n/a with the reason, a warning, and all the rest."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from tdgbench.cells.cell_tables import write_views
from tdgbench.cells.paths import RECORD_FILE
from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Record
from tdgbench.resources import conf_folder
from tdgbench.scenes import Description
from tdgbench.scoring import METRICS
from tdgbench.tables.build import build_tables
from tdgbench.tables.results import UNNAMED, Cell, read_results
from tdgbench.tables.show import show_tables
from tdgbench.tables.tables_command import main
from tests.helpers.records import write

ORBIT, NIGHT = (Description(name, "synthetic", "360") for name in ("orbit", "night"))


@pytest.fixture
def experiment(tmp_path) -> Path:
    """A planned experiment with a cell on each of two scenes."""
    Plan(scenes=[ORBIT, NIGHT], methods=["tdg"], inits=["colmap"]).write(tmp_path / "e")
    for scene in ("orbit", "night"):
        write(tmp_path / "e", scene=scene, dataset="synthetic", group="360", scores={"psnr": 21.0})
    return tmp_path / "e"


def test_runs_without_a_name_share_no_table(experiment):
    """Tables have cells of the last run's scenes: those of other captures would be rows of n/a. Others have all."""
    Plan(scenes=[NIGHT], methods=["tdg"]).write(experiment)
    assert {r.scene for r in read_results(experiment).records} == {"orbit", "night"}
    assert OmegaConf.load(conf_folder() / "config.yaml").name == UNNAMED
    unnamed = experiment.rename(experiment.with_name(UNNAMED))
    assert {r.scene for r in read_results(unnamed).records} == {"orbit", "night"}
    assert {r.scene for r in read_results(unnamed, of_last_run=True).records} == {"night"}
    assert {r.scene for r in build_tables(unnamed).records} == {"night"}


def cell_of(experiment: Path, scene: str) -> Path:
    return next((experiment / "cells" / "tdg" / "synthetic").glob(f"{scene}*")) / "colmap" / "seed0"


def values(experiment: Path, metric: str = "psnr") -> dict[str, float]:
    main = build_tables(experiment).main
    assert not main.duplicated(["method", "dataset", "scene", "metric"]).any()
    chosen = main[main["metric"] == metric]
    return dict(zip(chosen["scene"], chosen["value"], strict=True))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_text("{}"), lambda path: path.write_bytes(b"\xff"), lambda path: path.write_text("["
        * 100_000), lambda path: (path.unlink(), path.mkdir()), lambda path: (path.unlink(), os.mkfifo(path)),
        lambda path: (path.unlink(), path.symlink_to(path)),
        lambda path: path.write_text(path.read_text().replace("21.0", "Infinity")),
        lambda path: path.write_text(path.read_text().replace("21.0", '"21.0"')),
        lambda path: path.write_text(path.read_text().replace('"train": 360.0', '"train": null')),
    ],
    ids=["object", "bytes", "deep", "folder", "FIFO", "loop", "infinite", "text", "no time"],
)  # fmt: skip
def test_a_broken_record_is_na_with_its_reason(experiment, capsys, spoil):
    path = cell_of(experiment, "night") / RECORD_FILE
    spoil(path)
    found = values(experiment)
    assert found["orbit"] == 21.0 and np.isnan(found["night"]) and np.isnan(found["Average"])
    assert main([str(experiment)]) == 1
    printed = capsys.readouterr().out.replace("\n", "")
    assert "21.00" in printed and f"problem: its record cannot be read: {path} is not a record" in printed
    written = pd.read_csv(experiment / "tables" / "main.csv", keep_default_na=False).set_index(["scene", "metric"])
    assert written.loc[("night", "psnr"), "reason"].startswith("its record cannot be read: ")
    path.unlink() if not path.is_dir() else path.rmdir()
    assert main([str(experiment)]) == 0


def test_a_scene_that_is_planned_twice_counts_once(experiment):
    Plan(scenes=[ORBIT, ORBIT, NIGHT, replace(NIGHT, group="x")], methods=["tdg"], inits=["colmap"]).write(experiment)
    assert values(experiment) == {"orbit": 21.0, "night": 21.0, "Average": 21.0}


def test_a_cell_counts_once_and_in_its_own_folder(experiment):
    cell = cell_of(experiment, "night")
    shutil.copytree(cell, cell.with_name("seed7"))
    results = read_results(experiment)
    assert len(results.records) == 2 and "is in another cell's folder" in results.problems[0]
    assert str(cell.with_name("seed7")) in results.problems[0] and values(experiment)["night"] == 21.0
    shutil.rmtree(cell)
    assert np.isnan(values(experiment)["night"])


@pytest.mark.parametrize(
    "content", ["{", "[]", '{"scenes": 3}', '{"scenes": [{"scene": 1}]}', '{"scenes": [{}]}', '{"new": 1}', "\udcff"]
)
def test_a_broken_plan_is_a_problem(experiment, content):
    (experiment / "experiment.json").write_bytes(content.encode(errors="surrogateescape"))
    tables = build_tables(experiment)
    assert tables.main.set_index(["scene", "metric"]).loc[("orbit", "psnr"), "value"] == 21.0
    (problem,) = tables.problems
    assert "experiment.json is not the plan" in problem


@pytest.mark.parametrize(
    "content", [b"", b"view,psnr\n", b"view,psnr\nv\n", b"view,psnr\nv,high\n", b"view,psnr\nv,nan\n", b"\xff", b"a\n"]
)
def test_broken_scores_of_views_leave_their_interval_out(experiment, content):
    (cell_of(experiment, "orbit") / "views.csv").write_bytes(b"view,psnr\nv,20\nw,22\n")
    (cell_of(experiment, "night") / "views.csv").write_bytes(content)
    tables = build_tables(experiment)
    rows = tables.main.set_index(["scene", "metric"])
    assert rows.loc[("orbit", "psnr"), "ci95_low"] < 21 and np.isnan(rows.loc[("night", "psnr"), "ci95_low"])
    assert rows.loc[("night", "psnr"), "value"] == 21.0
    (problem,) = tables.problems
    assert "views.csv cannot be read" in problem


def test_settings_of_any_type_do_not_end_the_tables(experiment):
    for scene, config in (("orbit", {"budget": [1]}), ("night", {"budget": {"iterations": "9"}})):
        path = cell_of(experiment, scene) / RECORD_FILE
        content = {
            **json.loads(path.read_text()),
            "config": config,
            "init_points": {"how": 3},
            "environment": {"git": 1},
        }
        path.write_text(json.dumps(content))
    for kind in ("readings", "ablation", "main"):
        Plan(kind, scenes=[ORBIT, NIGHT], methods=["tdg"], inits=["colmap"]).write(experiment)
        show_tables(build_tables(experiment))


def test_claims_go_on_without_a_broken_record(experiment, capsys):
    (cell_of(experiment, "night") / RECORD_FILE).write_text("{}")
    assert main(["claims", str(experiment)]) == 1
    assert "undecided" in (printed := capsys.readouterr().out) and "problem: its record cannot be read" in printed


def test_a_folder_without_tables_does_not_hide_the_others(experiment, tmp_path, capsys):
    assert main([str(tmp_path / "[red]"), str(experiment)]) == 1
    out, err = capsys.readouterr()
    assert "[red] is not there" in err and "21.00" in out


def record(**fields):
    return Record(
        "tdg", "synthetic", "orbit", fields.pop("init", "colmap"), fields.pop("seed", 0), "demo", "", **fields
    )


def test_views_have_the_names_of_their_files(tmp_path):
    """Which may look like numbers, or like nothing."""
    cell = Cell(tmp_path / "cell", record())
    cell.folder.mkdir(parents=True)
    names = ["001", "1e3", "NA", "=a"]
    write_views(cell.folder, {name: {**dict.fromkeys(METRICS), "psnr": 20.0 + i} for i, name in enumerate(names)})
    views = cell.views
    assert list(views.index) == names and list(views["psnr"]) == [20, 21, 22, 23] and views["ssim"].isna().all()


@pytest.mark.parametrize("text", ["", "iteration,seconds\n1,2\n", "iteration,seconds,smoothed_psnr\n", "psnr\n1\n"])
def test_what_is_no_log_is_none(tmp_path, text):
    """Nor a table of views: `compare` and `claims` go on without it."""
    cell = Cell(tmp_path / "cell", record())
    cell.folder.mkdir(parents=True)
    for name in ("log.csv", "views.csv"):
        (cell.folder / name).write_text(text)
    assert cell.log is None and cell.views is None


def test_views_without_a_metric_have_none(tmp_path):
    cell = Cell(tmp_path / "cell", record())
    cell.folder.mkdir(parents=True)
    (cell.folder / "views.csv").write_text("view,psnr\na,1\n")
    assert cell.views["psnr"].tolist() == [1] and cell.views["depth_inconsistency"].isna().all()


def test_labels(tmp_path):
    assert Cell(tmp_path, record()).label == "TDg"
    assert Cell(tmp_path, record(init="random", seed=2)).label == "TDg (random), seed 2"


def test_copies_of_a_training_count_as_one_seed(tmp_path):
    for seed in range(3):
        write(tmp_path, seed=seed, hashes={"model.ply": "a" * 64})
    write(tmp_path, seed=3, hashes={"model.ply": "b" * 64})
    results = read_results(tmp_path)
    assert sorted(cell.record.seed for cell in results.finished) == [0, 3]
    assert results.problems[0].endswith("its files are those of seed 0; both count as one seed")
