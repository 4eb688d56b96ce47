import shutil

import numpy as np
import pytest

from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.scenes.synthetic.dataset import FOLDER, read_truth
from tests.helpers.layouts import celsius

SIZE = {"width": 48, "height": 36, "views": 10, "points": 300}


def load(root, name="turntable", noise_degC=0.0, drift_degC=0.0, **camera):
    errors = CaptureErrors(noise_degC=noise_degC, drift_degC=drift_degC, thermal_camera=ThermalErrors(**camera))
    return SyntheticDataset(str(root), ReadOptions(), **SIZE, errors=errors).load(name)


@pytest.mark.parametrize("name", ["turntable", "orbit"])
def test_the_written_truth_explains_the_images(tmp_path, name):
    clean = load(tmp_path / "clean", name, encoding="degC")
    scene = load(tmp_path, name, drift_degC=1.0, walk_degC=4.0, gain=0.05, vignette_degC=2.6, pattern_degC=0.2)
    truth = read_truth(scene.folder)
    camera = truth.camera
    assert scene.channels == 1 and truth.names == [view.name for view in scene.views]
    for view, ideal in zip(scene.views, clean.views, strict=True):
        index = int(truth.index([view.name])[0])
        expected = camera.shown(celsius(ideal, clean), index, np.zeros((36, 48)))
        assert np.abs(celsius(view, scene) - expected).max() < 1e-4  # no value is clipped
    assert np.ptp(camera.offsets) > 4 and np.ptp(camera.gains) > 0.03


def test_gain_control_loses_temperatures_and_states_its_limits(tmp_path):
    clean, scene = load(tmp_path / "clean", encoding="degC"), load(tmp_path, encoding="agc", walk_degC=2.0)
    camera = read_truth(scene.folder).camera
    assert scene.temperature is None and scene.channels == 1 and camera.limits.shape == (10, 2)
    for index, (view, ideal) in enumerate(zip(scene.views, clean.views, strict=True)):
        low, high = camera.limits[index]
        assert view.thermal.min() == 0 and view.thermal.max() == 1
        shown = celsius(ideal, clean) + camera.offsets[index]
        inside = (shown > low) & (shown < high)
        assert np.abs(low + (high - low) * view.thermal[..., 0] - shown)[inside].max() <= (high - low) / 510 + 1e-4


def test_readers_do_not_open_the_truth(tmp_path):
    scene = load(tmp_path, walk_degC=1.0)
    shutil.rmtree(scene.folder / FOLDER)
    again = FolderDataset(str(scene.folder), ReadOptions()).load(None)
    assert again.fingerprint == scene.fingerprint and len(again.views) == 10


def test_scenes_without_truth_say_so(tmp_path):
    scene = load(tmp_path)
    with pytest.raises(SceneError, match=r"has no camera/camera\.npz"):
        read_truth(scene.folder)


def test_a_damaged_truth_is_named(tmp_path):
    folder = load(tmp_path, gain=0.1).folder
    path = folder / FOLDER / "camera.npz"
    for content in (path.read_bytes()[:-100], b"", b"PK"):
        path.write_bytes(content)
        with pytest.raises(SceneError, match=r"camera\.npz cannot be read"):
            read_truth(folder)
    np.savez(path, names=np.array(["a"]))
    with pytest.raises(SceneError, match=r"camera\.npz cannot be read"):
        read_truth(folder)
