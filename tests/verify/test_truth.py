"""Ground truth is compared with the data: forged pictures, whose hashes and scores all fit, are found."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tdgbench.cells.folder import CellFolder, hashes_below
from tdgbench.cells.ground_truth import same_truth, truth_hash, truth_hashes
from tdgbench.cells.record import read_record
from tdgbench.compare.compare_command import main as compare
from tdgbench.packs import pack
from tdgbench.scoring.metrics.psnr import psnr_of
from tdgbench.site.site_pages import main as site
from tdgbench.verify import truth, verify

OURS = "cells/tdg/synthetic/turntable/colmap/seed0"


@pytest.fixture
def forged(small_results, tmp_path) -> Path:
    """An experiment of one cell whose ground truth is its own render ± 1, with all that follows from it."""
    experiment = tmp_path / "forged"
    shutil.copytree(small_results / OURS, experiment / OURS)
    forge(experiment / OURS)
    return experiment


def forge(cell: Path) -> None:
    rng, scores = np.random.default_rng(0), {}
    for path in sorted((cell / "renders").glob("*.png")):
        render = np.asarray(Image.open(path)).astype(int)
        target = np.clip(render + rng.integers(-1, 2, render.shape), 0, 255).astype(np.uint8)
        Image.fromarray(target).save(cell / "targets" / path.name)
        scores[path.stem] = float(psnr_of((((render - target) / 255) ** 2).mean()))
    table = list(csv.reader((cell / "views.csv").read_text().splitlines()))
    place = table[0].index("psnr")
    for row in table[1:]:
        row[place] = repr(scores[row[0]])
    (cell / "views.csv").write_text("\n".join(",".join(row) for row in table) + "\n")
    content = json.loads((cell / "record.json").read_text())
    content["scores"]["psnr"] = float(np.mean([*scores.values()]))
    content["truth"] = {view: truth_hash(CellFolder(cell, read_record(cell)).truth(view)) for view in scores}
    (cell / "record.json").write_text(json.dumps({**content, "hashes": hashes_below(cell)}))


def test_a_forged_truth_is_found_by_the_data(forged):
    """So is a range that would show other temperatures."""
    replace(read_record(forged / OURS), temperature_range=[14.0, 60.0]).write(forged / OURS)
    problems = verify(forged).problems
    found = [problem for problem in problems if "test views is not that of synthetic/turntable" in problem]
    assert any("temperature_range is [14.0, 60.0], by the data [14.0, 50.0]" in problem for problem in problems)
    assert len(found) == 1 and read_record(forged / OURS).scores["psnr"] > 45
    assert not any(": psnr of" in problem or "is not the ground truth" in problem for problem in problems)  # it fits


def test_another_data_set_s_name_is_found(small_results, tmp_path):
    cell = tmp_path / "a" / OURS
    shutil.copytree(small_results / OURS, cell)
    replace(read_record(cell), dataset="RGBT-Scenes").write(cell)
    assert any(
        "its data set is RGBT-Scenes, that of the data synthetic" in one for one in verify(tmp_path / "a").problems
    )


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"split": "every_8th"}, "its split is every_8th, that of the data eighty_twenty"),
        ({"group": "night"}, "its group is night, that of the data "),
        ({"assumed": {"values": "palette (pseudo-colour), not temperature"}}, "it says that images are in a palette"),
        ({"prior": {"made_from": "thermal images"}}, "prior.made_from is 'thermal images', its configuration has"),
        ({"parts": {"thermal": {"gaussians": 300, "parameters": 1}}}, "parts.thermal.parameters is 1, its model has"),
    ],
)
def test_facts_that_data_or_files_contradict_are_found(fields, said, small_results, tmp_path):
    cell = tmp_path / "a" / OURS
    shutil.copytree(small_results / OURS, cell)
    replace(read_record(cell), **fields).write(cell)
    assert any(said in problem for problem in verify(tmp_path / "a").problems)


def test_records_that_do_not_state_what_a_prior_is_made_from_in_their_configuration(small_results, tmp_path):
    """As those of 0.8.0."""
    cell = tmp_path / "a" / OURS
    shutil.copytree(small_results / OURS, cell)
    record = read_record(cell)
    del record.config["prior"]["made_from"]
    record.write(cell)
    assert not any("made_from" in problem for problem in verify(tmp_path / "a").problems)


def test_a_forged_rgb_truth_and_left_out_training_views_are_found(small_results, tmp_path):
    """Whatever the hashes say: of RGB, scores are columns of tables."""
    place = OURS.replace("tdg/", "msmg/", 1)
    cell = tmp_path / "a" / place
    shutil.copytree(small_results / place, cell)
    for path in (cell / "targets_rgb").glob("*.png"):
        shutil.copy(cell / "renders_rgb" / path.name, path)
    cameras = json.loads((cell / "cameras.json").read_text())
    cameras["train"] = dict(list(cameras["train"].items())[2:])
    (cell / "cameras.json").write_text(json.dumps(cameras))
    record = read_record(cell)
    views = {**record.views, "train": record.views["train"] - 2}
    replace(record, views=views, hashes=hashes_below(cell)).write(cell)
    problems = verify(tmp_path / "a").problems
    assert any("the RGB ground truth of 2 of 2 test views is not that of synthetic/turntable" in p for p in problems)
    assert any("its training views are not those of the data" in problem for problem in problems)


def test_what_was_not_compared_is_said(forged, small_results, tmp_path, capsys, monkeypatch):
    """Of scenes that are not built in, without --data; with it, they are read from there."""
    monkeypatch.setattr(truth, "BUILT_IN", "another")
    verified = verify(small_results)
    assert verified.problems == [] and verified.checked == 0
    of_none = "the ground truth was compared with the data of no cell; name the folder of its data with --data DIR"
    assert verified.of_data == of_none
    assert verify(small_results, data=tmp_path).checked == 3
    assert any("is not that of" in problem for problem in verify(forged, data=tmp_path).problems)
    with pytest.raises(ValueError, match="is no folder"):
        verify(small_results, data=tmp_path / "none")


@pytest.mark.parametrize("is_named", [False, True])
def test_a_built_in_scene_inside_another_data_set_is_made_again(is_named, small_results, tmp_path, monkeypatch):
    """In a scratch folder, even where --data names one, and as any other one counted."""
    record = read_record(small_results / OURS)
    errors = {"_target_": "tdgbench.scenes.synthetic.ThermalErrors", "walk_degC": 4.0}
    drifting = {"_target_": "tdgbench.scenes.synthetic.drifting.DriftingDataset", "errors": errors}
    record.config["dataset"] = {**drifting, "inner": record.config["dataset"]}
    with truth.true_data(tmp_path if is_named else None) as data:
        assert data.truth_of(record).images["thermal"].keys() == record.truth.keys() and not list(tmp_path.iterdir())
    monkeypatch.setattr(truth, "MOST_MADE", 1000)
    with truth.true_data(None) as data, pytest.raises(truth.NotCheckedError, match="takes long"):
        data.truth_of(record)


def test_large_built_in_scenes_are_not_made_again(small_results, tmp_path, monkeypatch):
    shutil.copytree(small_results / OURS, tmp_path / "a" / OURS)
    content = json.loads((tmp_path / "a" / OURS / "record.json").read_text())
    content["config"]["dataset"] |= {"width": 4096, "height": 4096, "views": 1000}
    (tmp_path / "a" / OURS / "record.json").write_text(json.dumps(content))
    monkeypatch.setattr("tdgbench.scenes.synthetic.dataset.write_scene", lambda *_: pytest.fail("made"))
    verified = verify(tmp_path / "a")
    assert verified.checked == 0 and "4096×4096×1000 px and views takes long" in verified.of_data


def test_a_view_that_options_enlarge_is_not_read(small_results, tmp_path, monkeypatch):
    shutil.copytree(small_results / OURS, tmp_path / "a" / OURS)
    content = json.loads((tmp_path / "a" / OURS / "record.json").read_text())
    content["config"]["dataset"]["options"]["width"] = 4096
    (tmp_path / "a" / OURS / "record.json").write_text(json.dumps(content))
    monkeypatch.setattr(truth, "truth_of", lambda _: pytest.fail("read"))
    verified = verify(tmp_path / "a")
    assert any("view000 would have 4096×3072 px" in problem for problem in verified.problems)
    assert verified.checked == 0


def test_many_built_in_scenes_are_not_made_again(small_results, monkeypatch):
    monkeypatch.setattr(truth, "MOST_MADE", 48 * 36 * 10)  # one of them
    verified = verify(small_results)
    assert verified.problems == [] and verified.checked == 2 and "takes long to make" in verified.of_data


def test_compare_says_whose_truth_it_was(forged, small_results, capsys):
    assert compare([str(small_results), str(forged)]) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert "protocol: ground truth: A's → another one in 2 of 2 test views" in out
    assert "not checked here: whether the stored ground truth is the data's (tdgbench verify)" in out
    assert compare([str(small_results), str(small_results)]) == 0


@pytest.mark.parametrize(("kept", "words"), [([], "unknown, since none is stored"), ([0], "that of other test views")])
def test_compare_says_where_it_has_no_truth_to_compare(forged, small_results, capsys, kept, words):
    record = read_record(forged / OURS)
    targets = sorted(name for name in record.hashes if name.startswith("targets/"))
    for number, name in enumerate(targets):
        if number not in kept:
            del record.hashes[name]
    record.write(forged / OURS)
    compare([str(small_results), str(forged)])
    assert f"ground truth: A's → {words}" in capsys.readouterr().out


def test_the_site_does_not_rank_rows_of_another_truth(forged, small_results, tmp_path):
    packs = [
        str(pack(folder, tmp_path / f"{folder.name}.zip", keep_paths=True)[0]) for folder in (small_results, forged)
    ]
    assert site([*packs, str(tmp_path / "site")]) == 0
    index = (tmp_path / "site/index.html").read_text()
    assert "No ranks on turntable" in index and "was not compared with the data" in index
    assert site([packs[0], str(tmp_path / "alone")]) == 0
    assert "No ranks" not in (tmp_path / "alone/index.html").read_text()


def test_records_state_the_truth_of_their_views(small_results, small_gray_scene):
    record = read_record(small_results / OURS)
    assert record.truth == truth_hashes(small_gray_scene.test) and len(record.truth) == record.views["test"]


def test_rounding_is_no_difference():
    truth_ = np.full((40, 50, 1), 100, np.uint8)
    other = truth_.copy()
    other[0, 0] += 1
    assert same_truth(truth_, other)
    other[0, 1:4] += 1
    assert not same_truth(truth_, other)
    other[:] = truth_
    other[0, 0] += 2
    assert not same_truth(truth_, other) and not same_truth(truth_, truth_[:, :-1])
