"""Pictures of training views come from the cell's own data, or there is a reason why not; nothing is written."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.bench.key import relevant_config
from tdgbench.bench.record import Record, read_record
from tdgbench.scoring import to_8bit
from tdgbench.view.cells import open_cell
from tdgbench.view.ground_truth import known_targets, training_views
from tests.helpers.configs import config
from tests.helpers.paths import ROOT
from tests.helpers.scenes import small_dataset

DATASETS = (ROOT / "conf" / "dataset").glob("*.yaml")


def test_training_views_have_the_scene_s_images(msmg_folder, data_root, small_gray_scene):
    cell = open_cell(msmg_folder)
    cell = replace(cell, ground_truth=training_views(cell.record, data_root))
    assert set(cell.ground_truth) == set(cell.train)
    for view in small_gray_scene.train:
        pictures = cell.pictures(view.name)
        assert np.array_equal(pictures["thermal"], to_8bit(view.thermal))
        assert np.array_equal(pictures["rgb"], to_8bit(view.rgb))


def test_data_that_are_not_there(msmg_folder, tmp_path):
    with pytest.raises(ValueError, match=r"turntable-48x36-\S+ is not there"):
        training_views(read_record(msmg_folder), tmp_path / "nothing")
    assert list(tmp_path.iterdir()) == []


def test_data_of_another_training(msmg_folder, data_root):
    with pytest.raises(ValueError, match=r"the files of turntable in .* are not those that it was trained on"):
        training_views(replace(read_record(msmg_folder), data="x"), data_root)


def test_every_data_set_of_the_project_is_known():
    assert "tdgbench.scenes.synthetic.SyntheticDataset" in known_targets()
    assert {config(f"dataset={name.stem}").dataset.loader._target_ for name in DATASETS} <= known_targets()


@pytest.mark.parametrize("place", ["outside", "inside", "reached", "nowhere"])
def test_nothing_else_that_a_record_names_is_run(msmg_folder, data_root, tmp_path, place):
    record = read_record(msmg_folder)
    loader = json.loads(json.dumps(record.config["dataset"]))
    evil = {"_target_": "pathlib.Path.touch", "self": {"_target_": "pathlib.Path", "_args_": [str(tmp_path / "x")]}}
    loader = {"outside": evil, "inside": {**loader, "options": [evil]}, "nowhere": {},
              "reached": {"_target_": "tdgbench.scenes.inputs.Path.touch"}}[place]  # fmt: skip
    with pytest.raises(ValueError, match="its data set is not one of tdgbench's"):
        training_views(replace(record, config={"dataset": loader}), data_root)
    assert list(tmp_path.iterdir()) == []


def test_images_that_were_changed_for_the_training_are_not_shown(msmg_folder, data_root):
    record = read_record(msmg_folder)
    for change in ({"camera": {"estimate": True}}, {"contrast": {"training": "clahe"}}):
        with pytest.raises(ValueError, match="camera or contrast changed"):
            training_views(replace(record, config={**record.config, **change}), data_root)


def test_the_folder_goes_to_the_innermost_data_set(data_root, tmp_path):
    folder = small_dataset(data_root).folder("turntable")
    small_dataset(data_root).load("turntable")
    cfg = config("dataset=drifting", f"data.root={folder}", "method=splat")
    dataset = instantiate(cfg.dataset.loader)
    loader = relevant_config(cfg, instantiate(cfg.method.method))["dataset"]
    record = Record("splat", "x", "turntable", "colmap", 0, "", "", config={"dataset": loader})
    record.data = dataset.load(None).fingerprint
    name = dataset.describe(None).scene
    assert set(training_views(replace(record, scene=name), folder)) == {v.name for v in dataset.load(None).train}
