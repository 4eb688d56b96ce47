from dataclasses import replace

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.cells.key import relevant_config
from tdgbench.scenes import SceneError
from tdgbench.scenes.synthetic import ThermalErrors
from tdgbench.scenes.synthetic.drifting import DriftingDataset, drifting
from tests.helpers.configs import config
from tests.helpers.scenes import small_dataset

ERRORS = ThermalErrors(walk_degC=2.0, gain=0.05, vignette_degC=1.5)


def in_degC(view, scene):
    return scene.temperature.min + (scene.temperature.max - scene.temperature.min) * view.thermal[..., 0]


def dataset(data_root, errors=ERRORS, **options) -> DriftingDataset:
    return DriftingDataset(small_dataset(data_root), errors, **options)


def test_every_view_shows_the_true_temperatures_with_the_camera_s_errors(data_root):
    made = dataset(data_root)
    scene, camera = made.load("turntable"), made.truth("turntable").camera
    clean = small_dataset(data_root).load("turntable")
    for index, (view, before) in enumerate(zip(scene.views, clean.views, strict=True)):
        degC = in_degC(before, clean)
        expected = camera.gains[index] * (degC - camera.reference) + camera.reference
        expected += camera.offsets[index] + camera.vignette
        assert in_degC(view, scene) == pytest.approx(expected, abs=1e-4)
        assert np.array_equal(view.true_temperature, before.true_temperature)
    values = np.array([view.thermal for view in scene.views])
    assert values.min() > 0 and values.max() < 1 and np.ptp(camera.offsets) > 1


@pytest.mark.parametrize("encoding", [None, "range", "agc"])
def test_what_is_assumed_is_of_the_errors(data_root, encoding):
    clean = small_dataset(data_root).load("turntable")
    clean.assumed["range"] = "image values 0 and 1 are 14 and 50 °C"  # as of float images
    scene, _ = drifting(clean, replace(ERRORS, encoding=encoding), 0)
    span = scene.temperature
    known = (
        "each view stretched, of unknown °C" if span is None else f"0 and 1 are {span.min:.4g} and {span.max:.4g} °C"
    )
    assert scene.assumed["values"] == f"gray, with errors of a thermal camera; {known}"
    assert "range" not in scene.assumed and scene.assumed["size"] == clean.assumed["size"]


def test_another_seed_or_error_is_another_scene(data_root):
    names = [{}, {"seed": 1}, {"noise_degC": 0.1}]
    scenes = [dataset(data_root, **one).load("turntable") for one in names]
    assert len({scene.fingerprint for scene in scenes}) == 3
    assert dataset(data_root).outline("turntable").scene.fingerprint == scenes[0].fingerprint
    assert not np.array_equal(scenes[0].train[0].thermal, scenes[1].train[0].thermal)
    assert np.array_equal(dataset(data_root).load("turntable").train[0].thermal, scenes[0].train[0].thermal)


def test_gain_control_loses_the_temperatures(data_root):
    scene = dataset(data_root, replace(ERRORS, encoding="agc")).load("turntable")
    assert scene.temperature is None and scene.train[0].true_temperature is not None
    assert all(view.thermal.min() == 0 and view.thermal.max() == 1 for view in scene.views)
    assert np.allclose(scene.train[0].thermal * 255, np.round(scene.train[0].thermal * 255), atol=1e-4)


def test_what_has_no_temperatures_is_an_error(data_root):
    with pytest.raises(SceneError, match="orbit has pseudo-colour"):
        dataset(data_root).load("orbit")
    scene = small_dataset(data_root).load("turntable")
    with pytest.raises(SceneError, match=r"set data\.temperature=\[MIN,MAX\]"):
        drifting(replace(scene, temperature=None), ERRORS, 0)


def test_a_capture_is_read_with_the_options_of_dataset_folder(data_root):
    folder = small_dataset(data_root).folder("turntable")
    small_dataset(data_root).load("turntable")
    cfg = config("dataset=drifting", f"data.root={folder}", "seed=3", "data.width=24", "method=3dgs")
    scene = instantiate(cfg.dataset.loader).load(None)
    assert scene.train[0].thermal.shape == (18, 24, 1) and scene.temperature.max > 42
    other = config("dataset=drifting", "data.root=elsewhere", "seed=3", "data.width=24", "method=3dgs")
    method = instantiate(cfg.method.method)
    assert relevant_config(cfg, method) == relevant_config(other, method)


def test_masked_pixels_have_no_part_in_range_and_gain(data_root):
    valid = np.ones((36, 48), bool)
    valid[:, :8] = False
    clean = small_dataset(data_root).load("turntable")
    for encoding in (None, "agc"):
        found = []
        for fill in (0.0, 1.0):

            def masked(view, fill=fill):
                image = np.where(valid[..., None], view.thermal, np.float32(fill))
                return replace(view, load_thermal=lambda: image, load_valid=lambda: valid)

            given = replace(clean, train=[masked(v) for v in clean.train], test=[masked(v) for v in clean.test])
            found.append(drifting(given, replace(ERRORS, encoding=encoding), 0)[0])
        assert found[0].temperature == found[1].temperature
        assert np.array_equal(found[0].train[0].thermal, found[1].train[0].thermal)
        if encoding is None:
            shown = np.array([in_degC(view, found[0])[valid] for view in found[0].views])
            assert found[0].temperature.min == pytest.approx(shown.min() - 1, abs=1e-3)
