import numpy as np
import pytest

from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tests.helpers.scenes import small_dataset

SIZE = {"width": 48, "height": 36, "views": 10, "points": 300}
DEFAULT = {  # means without options of errors: thermal images, RGB images, true depth; coordinates of the points
    "orbit": ((0.342397, 0.380762, 5.690734), (0.021753, -0.154948, 0.470129)),
    "night": ((0.328680, 0.016902, 5.793532), (0.698804, 1.983175, 1.029345)),
    "turntable": ((0.299513, 0.354606, 4.513177), (0.003714, -0.139293, 0.449953)),
    "facade": ((0.409151, 0.473738, 3.134044), (0.037880, -0.093089, 1.453600)),
}

CAMERA = {"thermal_camera": ThermalErrors(gain=0.05)}


def load(root, **errors):
    return SyntheticDataset(str(root), ReadOptions(), **SIZE, errors=CaptureErrors(**errors)).load("turntable")


@pytest.mark.parametrize("name", DEFAULT)
def test_scenes_without_further_errors_are_as_before(data_root, name):
    """Means, since the last bits of an exponential, and so the hash of a scene, differ between processors."""
    scene = small_dataset(data_root).load(name)
    images = [[np.mean(image) for image in (view.thermal, view.rgb, view.true_depth)] for view in scene.views]
    assert np.allclose(np.mean(images, axis=0), DEFAULT[name][0], atol=1e-4)
    assert np.allclose(scene.points.points.mean(0), DEFAULT[name][1], atol=1e-4)


def test_noise_and_drift_are_those_asked_for(data_root, tmp_path):
    clean = load(data_root)
    noisy, drifting = load(tmp_path, noise_degC=1.0), load(tmp_path, drift_degC=2.0)
    span = clean.temperature.max - clean.temperature.min
    pairs = zip(clean.views, noisy.views, drifting.views, strict=True)
    noise, drift = zip(*((b.thermal - a.thermal, c.thermal - a.thermal) for a, b, c in pairs), strict=True)
    assert np.std(noise) * span == pytest.approx(1.0, rel=0.1)
    expected = CaptureErrors(drift_degC=2.0).drifts(len(clean.views), 0)
    assert np.abs(np.median(drift, axis=(1, 2, 3)) * span - expected).max() < 0.2


def test_given_poses_differ_and_images_do_not(data_root, tmp_path):
    clean, wrong = load(data_root), load(tmp_path, pose_degrees=0.5, pose_units=0.02)
    turns, shifts = [], []
    for a, b in zip(clean.views, wrong.views, strict=True):
        assert np.array_equal(a.thermal, b.thermal) and np.array_equal(a.true_depth, b.true_depth)
        error = b.camera.world_to_camera @ np.linalg.inv(a.camera.world_to_camera)
        turns.append(np.degrees(np.arccos((np.trace(error[:3, :3]) - 1) / 2)))
        shifts.append(np.linalg.norm(error[:3, 3]))
    assert np.sqrt(np.mean(np.square(turns)) / 3) == pytest.approx(0.5, rel=0.4)
    assert np.sqrt(np.mean(np.square(shifts)) / 3) == pytest.approx(0.02, rel=0.4)
    assert np.array_equal(clean.points.points, wrong.points.points)


def test_each_set_of_errors_has_a_folder(tmp_path):
    folders = {
        load(tmp_path, **errors).folder.name for errors in ({}, {"noise_degC": 0.5}, {"pose_units": 0.01}, CAMERA)
    }
    assert len(folders) == 4


def test_only_errors_of_the_camera_have_a_truth():
    assert not CaptureErrors(noise_degC=1.0, pose_units=0.1).has_truth
    assert (
        CaptureErrors(drift_degC=1.0).has_truth
        and CaptureErrors(thermal_camera=ThermalErrors(pattern_degC=1.0)).has_truth
    )
