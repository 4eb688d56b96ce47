"""Cells of `thermal_camera=estimated`: the record holds the response, and scores are of what the camera shows."""

import csv
import json
import shutil

import numpy as np
import pytest
from hydra.utils import instantiate
from PIL import Image

from tdgbench.cells.record import read_all
from tdgbench.cells.renders import background_of, render_model, response_of
from tdgbench.scoring.metrics.psnr import psnr
from tdgbench.scoring.scored_view import to_8bit
from tdgbench.splats.ply import load_ply
from tdgbench.thermal import corrected, estimate_camera
from tdgbench.verify import verify, verify_cell
from tests.helpers.cells import run_quietly
from tests.helpers.configs import SMALL, config

STILL = (
    "scene=turntable", "dataset.loader.width=64", "dataset.loader.height=48", "dataset.loader.views=15",
    "dataset.loader.points=2500", "dataset.loader.errors.thermal_camera.encoding=degC",
)  # fmt: skip
DRIFT = (
    *STILL, "dataset.loader.errors.thermal_camera.walk_degC=4", "dataset.loader.errors.thermal_camera.shutter_views=6",
    "dataset.loader.errors.thermal_camera.vignette_degC=2.6",
)  # fmt: skip


@pytest.fixture(scope="module")
def results_of(tmp_path_factory):
    """A function that runs a cell, by default of a drifting scene; it gives its configuration and results folder."""
    root = tmp_path_factory.mktemp("drifting")

    def run(name, of=DRIFT):
        cfg = config(
            *SMALL, "budget=demo", "budget.iterations=60", "method=3dgs", f"data.root={root}",
            f"results={root / name}", "thermal_camera=estimated", *of,
        )  # fmt: skip
        outcome = run_quietly(cfg)
        assert outcome.status == "ok", outcome
        return cfg, root / name

    return run


@pytest.fixture(scope="module")
def results(results_of):
    return results_of("results")


@pytest.fixture(scope="module")
def cell(results):
    (record,) = read_all(results[1] / "single")
    (file,) = (results[1] / "single").rglob("record.json")
    return record, file.parent


def picture(path):
    return np.asarray(Image.open(path), np.float32) / np.float32(255)


def test_the_record_says_what_was_estimated(cell):
    estimated = cell[0].thermal_camera["estimated"]
    assert "offsets" in estimated["terms"] and estimated["unit"] == "°C"
    assert estimated["offset_rms"] > 0.5 and estimated["residual_after"] < estimated["residual_before"]
    assert any(note.startswith("thermal camera: training views are corrected") for note in cell[0].notes)
    assert cell[0].seconds["thermal_camera"] > 0 and cell[0].setting("thermal_camera.estimate") is True


def test_what_cannot_be_estimated_is_a_note(results_of):
    (record,) = read_all(results_of("orbit", of=("scene=orbit",))[1] / "single")
    assert "pseudo-coloured" in record.thermal_camera["estimated"]["unknown"]
    (note,) = (note for note in record.notes if note.startswith("thermal camera: "))
    assert note.startswith("thermal camera: images stay as they are: ")


def test_the_record_holds_what_training_views_were_corrected_for(results, cell):
    scene = instantiate(results[0].dataset.loader).load("turntable")
    found = corrected(scene, estimate_camera(scene))
    response = response_of(cell[0])
    assert response == found.response and not response.is_ideal
    assert set(response.offsets) >= {view.name for view in scene.test} and response.vignette
    assert cell[0].temperature_range == pytest.approx([scene.temperature.min, scene.temperature.max])
    assert cell[0].thermal_camera["estimated"]["undetermined"] == 0


def test_a_corrected_cell_is_verified(results):
    assert verify(results[1] / "single")[:7] == (1, 1, [], 1, (), (), ())


def test_renders_are_what_the_camera_shows_and_targets_are_untouched(results, cell):
    record, folder = cell
    scene, model = instantiate(results[0].dataset.loader).load("turntable"), load_ply(folder / "model.ply")
    for view in scene.test:
        render = render_model(model, view.camera, background=background_of(record, "thermal")).image.numpy()
        shown = to_8bit(response_of(record).shown(render, view.name))[..., 0]
        stored = np.asarray(Image.open(folder / "renders" / f"{view.name}.png"))
        assert np.abs(stored.astype(int) - shown).max() <= 1
        assert np.abs(stored.astype(int) - to_8bit(render)[..., 0]).mean() > 1
        target = np.asarray(Image.open(folder / "targets" / f"{view.name}.png"))
        assert np.array_equal(target, to_8bit(view.thermal)[..., 0])


def test_scores_are_those_of_the_pictures(cell):
    record, folder = cell
    with (folder / "views.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    pairs = [[picture(folder / sub / f"{row['view']}.png") for sub in ("renders", "targets")] for row in rows]
    found = [psnr(render, target) for render, target in pairs]
    assert [float(row["psnr"]) for row in rows] == pytest.approx(found, abs=1e-4)
    assert record.scores["psnr"] == pytest.approx(np.mean(found), abs=1e-4)
    span = record.temperature_range[1] - record.temperature_range[0]
    errors = [np.abs(render - target).mean() for render, target in pairs]
    assert record.scores["mae_degC"] == pytest.approx(span * np.mean(errors), abs=1e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda response: response["offsets"].update(view000=0.5), "renders/view000.png is not what model.ply gives"),
        (lambda response: response.update(high=2.0), "renders/view005.png is not what model.ply gives"),
        (lambda response: response.clear(), "renders/view000.png is not what model.ply gives"),
        (lambda response: response.update(offset={}), "cannot be checked"),
    ],
    ids=["offset of a test view", "range", "none", "unknown name"],
)
def test_another_response_in_the_record_is_found(cell, tmp_path, change, said):
    copy = shutil.copytree(cell[1], tmp_path / "cell")
    content = json.loads((copy / "record.json").read_text())
    change(content["thermal_camera"]["estimated"]["response"])
    (copy / "record.json").write_text(json.dumps(content))
    assert any(said in problem for problem in verify_cell(copy))
