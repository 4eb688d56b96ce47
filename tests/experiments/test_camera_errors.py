import numpy as np
import pytest

from tdgbench.cells.record import Record
from tdgbench.experiments.thermal_camera import camera_errors
from tdgbench.scenes.synthetic import ThermalErrors
from tdgbench.scenes.synthetic.capture import CameraTruth
from tdgbench.thermal.camera import normalized_truth
from tdgbench.thermal.maps import TERMS, legendre_basis

NAMES = [f"view{index}" for index in range(12)]
ERRORS = ThermalErrors(walk_degC=3.0, gain=0.05)


def truth(**errors) -> CameraTruth:
    camera = (ThermalErrors(**errors) if errors else ERRORS).drawn((40, 30), (10.0, 30.0), np.zeros(12), [0])
    return CameraTruth(NAMES, camera)


def record(**camera) -> Record:
    return Record("3dgs", "synthetic", "a", "colmap", 0, "", "", temperature_range=[10.0, 30.0], thermal_camera=camera)


def facts(offsets, gains, reference=20.0, views=NAMES):
    return {"views": views, "reference": reference, "offsets": list(offsets), "gains": list(gains),
            "vignette": [0.0] * len(TERMS)}  # fmt: skip


def test_a_camera_that_is_found_has_no_errors():
    true = truth()
    found = facts(true.camera.offsets, true.camera.gains, true.camera.reference)
    assert max(camera_errors(record(estimated=found), true, NAMES).values()) < 1e-9


def test_a_vignette_that_is_found_has_no_errors():
    true = truth(vignette_degC=2.0)
    normalized = normalized_truth(true, NAMES, true.camera.reference)
    grid = [(np.arange(size) + 0.5) / size for size in (40, 30)]
    terms = legendre_basis(*(axis.ravel() for axis in np.meshgrid(*grid)))
    shape = np.linalg.lstsq(terms - terms.mean(axis=0), normalized.vignette.ravel(), rcond=None)[0]
    found = facts(normalized.response.offsets, normalized.response.gains, true.camera.reference)
    none = camera_errors(record(estimated=found), true, NAMES)
    one = camera_errors(record(estimated=found | {"vignette": shape.tolist()}), true, NAMES)
    assert max(one.values()) < 1e-6 < 0.5 < none["vignette_degC_worst"]


@pytest.mark.parametrize("camera", [{}, {"estimated": {"unknown": "no points"}}])
def test_the_errors_of_an_ideal_camera_are_the_drift(camera):
    true, views = truth(), NAMES[1:]
    drift = normalized_truth(true, views, true.camera.reference).response.offsets
    found = camera_errors(record(**camera), true, views)
    assert found["offset_degC_worst"] == pytest.approx(np.abs(drift).max())


def test_without_temperatures_there_is_nothing_to_compare():
    one = record(estimated={"unknown": "no points"})
    one.temperature_range = None
    assert camera_errors(one, truth(encoding="agc"), NAMES) == {}
