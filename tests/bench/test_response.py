import numpy as np
import pytest
from rich.console import Console

from tdgbench.bench.cell import run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.bench.response import correct_training_views, refined_facts
from tdgbench.scenes import TemperatureRange
from tdgbench.training.camera import CameraOptions, IdealCamera, Refinement, camera_of
from tests.helpers.configs import SMALL, config

DRIFT = (
    "scene=turntable", "dataset.loader.errors.camera.walk_degC=4", "dataset.loader.errors.camera.shutter_views=6",
    "dataset.loader.width=64", "dataset.loader.height=48", "dataset.loader.views=15", "dataset.loader.points=2500",
)  # fmt: skip


@pytest.fixture
def record_of(data_root, tmp_path):
    def run(*overrides, root=data_root):
        cfg = config(
            *SMALL, "budget=demo", "budget.iterations=40", "method=splat", f"data.root={root}", f"results={tmp_path}",
            *overrides,
        )  # fmt: skip
        outcome = run_cell(cfg, "", CellProgress(Console(quiet=True), 40))
        assert outcome.status == "ok", outcome
        (record,) = read_all(tmp_path / "single")
        return record

    return run


def test_a_record_says_what_was_estimated_and_refined(record_of, tmp_path):
    record = record_of("camera=both", *DRIFT, root=tmp_path / "drifting")
    estimated, refined = record.camera["estimated"], record.camera["refined"]
    assert "offsets" in estimated["terms"] and estimated["unit"] == refined["unit"] == "°C"
    assert estimated["offset_rms"] > 0.5 and estimated["residual_after"] < estimated["residual_before"]
    assert refined["offset_rms"] < estimated["offset_rms"]
    assert any(note.startswith("camera: training views are corrected") for note in record.notes)
    assert record.seconds["camera"] > 0 and record.setting("camera.estimate") is True
    again = record_of("camera=ideal", *DRIFT, root=tmp_path / "drifting")
    assert again.key != record.key and again.camera == {} and "camera" not in again.seconds


def test_what_cannot_be_estimated_is_a_note(record_of):
    record = record_of("camera=both", "scene=orbit")
    for kind in ("estimated", "refined"):
        assert "pseudo-colour" in record.camera[kind]["unknown"]
    notes = [note for note in record.notes if note.startswith("camera: ")]
    assert [note[:32] for note in notes] == [
        "camera: images stay as they are:"[:32],
        "camera: none is refined: orbit h"[:32],
    ]


def test_images_stay_where_the_camera_is_unknown(small_scene):
    found = correct_training_views(small_scene)
    assert found.scene is small_scene and "pseudo-colour" in found.facts["unknown"]


def test_facts_are_in_the_unit_of_the_scene(small_gray_scene):
    options = CameraOptions(refine=Refinement(0.02, 0.02, 0.0005, 0.5, 0.01, 0.01))
    camera = camera_of(small_gray_scene, options, 10, [])
    camera.views.values[0, 0], camera.views.values[1, 0] = 0.1, -0.1
    span = small_gray_scene.temperature.max - small_gray_scene.temperature.min
    assert isinstance(small_gray_scene.temperature, TemperatureRange)
    facts = refined_facts(camera, small_gray_scene)
    assert facts["unit"] == "°C" and facts["offset_range"] == pytest.approx([-0.1 * span, 0.1 * span], abs=1e-4)
    assert facts["offset_rms"] == pytest.approx(0.1 * span * np.sqrt(2 / len(small_gray_scene.train)), abs=1e-4)
    assert refined_facts(IdealCamera(), small_gray_scene) == {}
