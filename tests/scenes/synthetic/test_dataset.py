import os
import shutil

import numpy as np
import pytest

from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.scenes.synthetic.dataset import FOLDER
from tests.helpers.layouts import celsius, read_truth

TINY = {"width": 24, "height": 18, "views": 5, "points": 50}
SIZE = {"width": 48, "height": 36, "views": 10, "points": 300}


def load(root, **errors):
    return SyntheticDataset(str(root), ReadOptions(), **SIZE, errors=CaptureErrors(**errors)).load("turntable")


def test_a_view_past_the_end_of_the_world_is_an_error(tmp_path):
    tall = SyntheticDataset(tmp_path, ReadOptions(), width=16, height=80, views=2)
    with pytest.raises(SceneError, match=r"pixels of a view show nothing.*dataset\.loader\.width"):
        tall.load("facade")
    assert list((tmp_path / "synthetic").iterdir()) == []


def test_a_root_that_is_no_folder_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match=r"no scene can be written to .*file \(Not a directory\); set data\.root=DIR"):
        SyntheticDataset(tmp_path / "file", ReadOptions()).load("orbit")


def test_same_seed_same_files(tmp_path):
    first, again, other = (
        SyntheticDataset(str(tmp_path / folder), ReadOptions(), **TINY, seed=seed).load("night").fingerprint
        for folder, seed in (("a", 0), ("b", 0), ("c", 1))
    )
    assert first == again != other


@pytest.mark.skipif(os.name == "nt", reason="Windows has no umask")
def test_permissions_follow_the_umask(tmp_path):
    before = os.umask(0o022)
    try:
        scene = SyntheticDataset(str(tmp_path), ReadOptions(), **TINY).load("night")
    finally:
        os.umask(before)
    paths = [scene.folder, *scene.folder.rglob("*")]
    assert {(path.is_dir(), path.stat().st_mode & 0o777) for path in paths} == {(True, 0o755), (False, 0o644)}
    assert [path.name for path in scene.folder.parent.iterdir()] == [scene.folder.name]


@pytest.mark.parametrize("points", [0, 4])
def test_a_scene_may_have_no_points(tmp_path, points):
    scene = SyntheticDataset(str(tmp_path), ReadOptions(), **TINY | {"points": points}).load("night")
    assert scene.points is None and len(scene.train) == 4


def test_noise_and_drift_are_those_asked_for(data_root, tmp_path):
    clean, noisy, drifting = load(data_root), load(tmp_path, noise_degC=1.0), load(tmp_path, drift_degC=2.0)
    plain, noise, drift = (np.array([view.thermal for view in scene.views]) for scene in (clean, noisy, drifting))
    span = clean.temperature.max - clean.temperature.min
    assert np.std(noise - plain) * span == pytest.approx(1.0, rel=0.1)
    expected = CaptureErrors(drift_degC=2.0).drawn_camera((48, 36), (0.0, 1.0), 10, 0).offsets
    assert np.std(expected) == pytest.approx(2, rel=0.5)
    assert np.abs(np.median(drift - plain, axis=(1, 2, 3)) * span - expected).max() < 0.2


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


def test_a_resized_scene_has_the_resized_truth(data_root):
    whole = load(data_root)
    half = SyntheticDataset(str(data_root), ReadOptions(width=24), **SIZE).load("turntable")
    for big, small in zip(whole.views, half.views, strict=True):
        assert small.thermal.shape == (18, 24, 1)
        for name in ("true_depth", "true_temperature"):
            expected = getattr(big, name).reshape(18, 2, 24, 2).mean(axis=(1, 3))
            assert np.allclose(getattr(small, name), expected, rtol=1e-5)


def test_each_set_of_errors_has_a_folder(tmp_path):
    some = ({}, {"noise_degC": 0.5}, {"pose_units": 0.01}, {"thermal_camera": ThermalErrors(gain=0.05)})
    datasets = [SyntheticDataset(str(tmp_path), ReadOptions(), errors=CaptureErrors(**errors)) for errors in some]
    assert len({dataset.folder("turntable") for dataset in datasets}) == 4


def load_camera(root, name="turntable", noise_degC=0.0, drift_degC=0.0, **camera):
    errors = CaptureErrors(noise_degC=noise_degC, drift_degC=drift_degC, thermal_camera=ThermalErrors(**camera))
    return SyntheticDataset(str(root), ReadOptions(), **SIZE, errors=errors).load(name)


@pytest.mark.parametrize("name", ["turntable", "orbit"])
def test_the_written_truth_explains_the_images(tmp_path, name):
    clean = load_camera(tmp_path / "clean", name, encoding="degC")
    scene = load_camera(tmp_path, name, drift_degC=1.0, walk_degC=4.0, gain=0.05, vignette_degC=2.6, pattern_degC=0.2)
    truth = read_truth(scene.folder)
    camera = truth.camera
    assert scene.channels == 1 and truth.names == [view.name for view in scene.views]
    for view, ideal in zip(scene.views, clean.views, strict=True):
        index = int(truth.index([view.name])[0])
        expected = camera.shown(celsius(ideal, clean), index, np.zeros((36, 48)))
        assert np.abs(celsius(view, scene) - expected).max() < 1e-4  # no value is clipped
    assert np.ptp(camera.offsets) > 4 and np.ptp(camera.gains) > 0.03


def test_gain_control_loses_temperatures_and_states_its_limits(tmp_path):
    clean = load_camera(tmp_path / "clean", encoding="degC")
    scene = load_camera(tmp_path, encoding="agc", walk_degC=2.0)
    camera = read_truth(scene.folder).camera
    assert scene.temperature is None and scene.channels == 1 and camera.limits.shape == (10, 2)
    for index, (view, ideal) in enumerate(zip(scene.views, clean.views, strict=True)):
        low, high = camera.limits[index]
        assert view.thermal.min() == 0 and view.thermal.max() == 1
        shown = celsius(ideal, clean) + camera.offsets[index]
        inside = (shown > low) & (shown < high)
        assert np.abs(low + (high - low) * view.thermal[..., 0] - shown)[inside].max() <= (high - low) / 510 + 1e-4


def test_readers_do_not_open_the_truth(tmp_path):
    scene = load_camera(tmp_path, walk_degC=1.0)
    shutil.rmtree(scene.folder / FOLDER)
    again = FolderDataset(str(scene.folder), ReadOptions()).load(None)
    assert again.fingerprint == scene.fingerprint and len(again.views) == 10
