from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from tdgbench.bench import response
from tdgbench.bench.cell import run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.bench.response import prepare, refined_facts, too_short
from tdgbench.scenes import TemperatureRange
from tdgbench.thermal import ThermalCamera, Unknown
from tdgbench.thermal.polynomials import TERMS
from tdgbench.training.camera import CameraOptions, IdealCamera, Refinement, camera_of
from tests.helpers.configs import SMALL, config

STILL = (
    "scene=turntable", "dataset.loader.width=64", "dataset.loader.height=48", "dataset.loader.views=15",
    "dataset.loader.points=2500", "dataset.loader.errors.camera.encoding=degC",
)  # fmt: skip
DRIFT = (*STILL, "dataset.loader.errors.camera.walk_degC=4", "dataset.loader.errors.camera.shutter_views=6")
REFINE = Refinement(0.02, 0.02, 0.0005, 20, 10, 0.01)


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
    assert any("too soon to learn" in note for note in record.notes)  # 40 iterations
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
    options = CameraOptions(estimate=True, refine=REFINE)
    found = prepare(small_scene, options)
    assert found.scene is small_scene and "pseudo-colour" in found.facts["unknown"] and found.options == options


def estimated(scene, terms):
    views = len(scene.train)
    zeros = np.zeros(views)
    return ThermalCamera(
        unit="°C", views=tuple(view.name for view in scene.train), reference=20.0, offsets=zeros, gains=1 + zeros,
        vignette=np.zeros(len(TERMS)), columns=None, rows=None, offset_errors=zeros, gain_errors=zeros,
        vignette_errors=np.zeros(len(TERMS)), residual_before=0.1, residual_after=0.1,
        sightings=np.full(views, 99), terms=terms,
    )  # fmt: skip


@pytest.mark.parametrize("estimate", [True, False])
@pytest.mark.parametrize("supported", [("vignette",), ("vignette", "offsets"), ("vignette", "offsets", "gains")])
def test_only_supported_terms_are_refined(small_gray_scene, monkeypatch, estimate, supported):
    monkeypatch.setattr(response, "estimate_camera", lambda scene: estimated(scene, (*supported, "pattern")))
    found = prepare(small_gray_scene, CameraOptions(estimate=estimate, refine=REFINE))
    assert sorted(found.options.refine.terms) == sorted(supported)
    assert (found.scene is small_gray_scene) != estimate and found.facts["terms"] == [*supported, "pattern"]
    one = prepare(small_gray_scene, CameraOptions(refine=replace(REFINE, terms=["gains", "vignette"])))
    assert set(one.options.refine.terms) == {"gains", "vignette"} & set(supported)


def test_nothing_is_refined_where_nothing_is_supported(small_gray_scene, monkeypatch):
    monkeypatch.setattr(response, "estimate_camera", lambda scene: estimated(scene, ()))
    found = prepare(small_gray_scene, CameraOptions(refine=REFINE))
    assert found.options.refine is None and found.notes == [
        "camera: nothing is refined: sparse points do not support vignette, offsets, gains"
    ]


def test_a_capture_without_drift_is_trained_as_with_an_ideal_camera(record_of, tmp_path):
    steady = (*STILL, "method=splat")
    refined, ideal = (record_of(f"camera={one}", *steady, root=tmp_path / "still") for one in ("refined", "ideal"))
    assert "offsets" not in refined.camera["estimated"]["terms"] and "refined" not in refined.camera
    assert any("nothing is refined" in note for note in refined.notes)
    assert refined.hashes["model.ply"] == ideal.hashes["model.ply"]


def test_a_capture_without_points_is_refined_with_a_note(record_of, tmp_path, monkeypatch):
    monkeypatch.setattr(response, "estimate_camera", lambda scene: Unknown("it has no sparse points"))
    record = record_of("camera=refined", *DRIFT, root=tmp_path / "drifting")
    assert record.camera["refined"]["offset_rms"] > 0.1
    assert "camera: refined whether or not the capture needs it: it has no sparse points" in record.notes


def test_facts_are_in_the_unit_of_the_scene(small_gray_scene):
    options = CameraOptions(refine=REFINE)
    camera = camera_of(small_gray_scene, options, [])
    camera.views.values[0, 0], camera.views.values[1, 0] = 0.1, -0.1
    span = small_gray_scene.temperature.max - small_gray_scene.temperature.min
    assert isinstance(small_gray_scene.temperature, TemperatureRange)
    facts = refined_facts(camera, small_gray_scene)
    assert facts["unit"] == "°C" and facts["offsets"][:3] == pytest.approx([0.1 * span, -0.1 * span, 0], abs=1e-4)
    assert facts["views"] == [view.name for view in small_gray_scene.train] and set(facts["gains"]) == {1.0}
    at_reference = small_gray_scene.temperature.min + span * camera.reference
    assert facts["reference"] == pytest.approx(at_reference, abs=1e-4) and len(facts["vignette"]) == len(TERMS)
    assert facts["offset_rms"] == pytest.approx(0.1 * span * np.sqrt(2 / len(small_gray_scene.train)), abs=1e-4)
    assert refined_facts(IdealCamera(), small_gray_scene) == {}


def test_a_training_that_ends_before_a_term_is_learned_says_so(small_gray_scene):
    camera = camera_of(small_gray_scene, CameraOptions(refine=replace(REFINE, terms=["offsets", "vignette"])), [])
    camera.views.steps[:] = 20
    assert too_short(camera) == ["camera: training ended after 20 rounds of the views, too soon to learn vignette"]
    camera.views.steps[0] = 200
    assert too_short(camera) == [] == too_short(IdealCamera())
