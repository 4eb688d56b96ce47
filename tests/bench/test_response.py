import pytest

from tdgbench.cells.record import read_all
from tests.helpers.cells import run_quietly
from tests.helpers.configs import SMALL, config

STILL = (
    "scene=turntable", "dataset.loader.width=64", "dataset.loader.height=48", "dataset.loader.views=15",
    "dataset.loader.points=2500", "dataset.loader.errors.thermal_camera.encoding=degC",
)  # fmt: skip
DRIFT = (
    *STILL,
    "dataset.loader.errors.thermal_camera.walk_degC=4",
    "dataset.loader.errors.thermal_camera.shutter_views=6",
)


@pytest.fixture
def record_of(data_root, tmp_path):
    def run(*overrides, root=data_root):
        cfg = config(
            *SMALL, "budget=demo", "budget.iterations=40", "method=3dgs", f"data.root={root}", f"results={tmp_path}",
            *overrides,
        )  # fmt: skip
        outcome = run_quietly(cfg)
        assert outcome.status == "ok", outcome
        (record,) = read_all(tmp_path / "single")
        return record

    return run


def test_a_record_says_what_was_estimated(record_of, tmp_path):
    record = record_of("thermal_camera=estimated", *DRIFT, root=tmp_path / "drifting")
    estimated = record.thermal_camera["estimated"]
    assert "offsets" in estimated["terms"] and estimated["unit"] == "°C"
    assert estimated["offset_rms"] > 0.5 and estimated["residual_after"] < estimated["residual_before"]
    assert any(note.startswith("thermal camera: training views are corrected") for note in record.notes)
    assert record.seconds["thermal_camera"] > 0 and record.setting("thermal_camera.estimate") is True
    again = record_of("thermal_camera=ideal", *DRIFT, root=tmp_path / "drifting")
    assert again.key != record.key and again.thermal_camera == {} and "thermal_camera" not in again.seconds


def test_what_cannot_be_estimated_is_a_note(record_of):
    record = record_of("thermal_camera=estimated", "scene=orbit")
    assert "pseudo-coloured" in record.thermal_camera["estimated"]["unknown"]
    (note,) = (note for note in record.notes if note.startswith("thermal camera: "))
    assert note.startswith("thermal camera: images stay as they are: ")


def test_a_capture_without_drift_keeps_its_offsets(record_of, tmp_path):
    record = record_of("thermal_camera=estimated", *STILL, root=tmp_path / "still")
    assert "offsets" not in record.thermal_camera["estimated"]["terms"]
    assert record.thermal_camera["estimated"]["offset_rms"] == 0
