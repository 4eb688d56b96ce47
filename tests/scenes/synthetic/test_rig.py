import json

import numpy as np
import pytest
from hydra.utils import instantiate
from scipy.ndimage import map_coordinates

from tdgbench.bench.options import OptionError, check_options
from tdgbench.scenes import ReadOptions, SceneError
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, TrueRig
from tdgbench.scenes.synthetic.dataset import FOLDER, RIG
from tests.helpers.configs import config
from tests.helpers.layouts import read_truth

SIZE = {"width": 96, "height": 72, "views": 5, "points": 300}
RIG_OF_ALL = TrueRig([0.3, -0.1, 0.05], [1, -2, 1], 1.1, [0.02, 0.01], [-0.2, 0.05])


def dataset(root, rig=TrueRig()) -> SyntheticDataset:  # noqa: B008
    return SyntheticDataset(str(root), ReadOptions(), **SIZE, errors=CaptureErrors(noise_degC=0.0, rig=rig))


def pixels():
    x, y = np.meshgrid(np.arange(SIZE["width"]) + 0.5, np.arange(SIZE["height"]) + 0.5)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def test_thermal_pixels_show_what_the_given_camera_sees_elsewhere(tmp_path):
    """A thermal pixel's point, by its true depth, has its true temperature in the images of the given camera, too."""
    rig, world = RIG_OF_ALL, "wall"
    plain, scene = dataset(tmp_path).load(world), dataset(tmp_path, rig).load(world)
    for view, given in zip(scene.views, plain.views, strict=True):
        camera = rig.camera(view.camera)
        straight = rig.undistorted(pixels(), camera.K)
        z = view.true_depth.ravel().astype(np.float64)
        local = np.concatenate([(straight - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]], np.ones((len(z), 1))], axis=1)
        points = (local * z[:, None] - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]
        there, depth = given.camera.project(points)
        x, y = there.T - 0.5
        seen = (x > 0) & (y > 0) & (x < SIZE["width"] - 1) & (y < SIZE["height"] - 1)
        found = map_coordinates(given.true_temperature, [y[seen], x[seen]], order=1)
        surface = map_coordinates(given.true_depth, [y[seen], x[seen]], order=1)
        assert seen.mean() > 0.6
        assert np.mean(np.abs(surface - depth[seen]) < 0.03) > 0.9  # the others are hidden, or at an edge
        assert np.median(np.abs(found - view.true_temperature.ravel()[seen])) < 0.03
        assert not np.array_equal(view.thermal, given.thermal)


def test_model_and_rgb_images_are_the_given_camera_s(tmp_path):
    plain, scene = dataset(tmp_path).load("facade"), dataset(tmp_path, RIG_OF_ALL).load("facade")
    assert np.array_equal(plain.points.points, scene.points.points)
    for before, after in zip(plain.views, scene.views, strict=True):
        assert np.array_equal(before.camera.world_to_camera, after.camera.world_to_camera)
        assert np.array_equal(before.rgb, after.rgb) and np.array_equal(before.camera.K, after.camera.K)


def test_no_rig_changes_nothing_and_has_no_file(tmp_path):
    plain, scene = dataset(tmp_path / "a").load("night"), dataset(tmp_path / "b", TrueRig([0, 0, 0])).load("night")
    assert plain.fingerprint == scene.fingerprint and plain.folder.name == scene.folder.name
    assert not (plain.folder / FOLDER).exists()


def test_the_truth_is_written(tmp_path):
    scene = dataset(tmp_path, RIG_OF_ALL).load("night")
    assert TrueRig(**json.loads((scene.folder / FOLDER / RIG).read_text(encoding="utf-8"))) == RIG_OF_ALL
    assert not read_truth(scene.folder).camera.offsets.any()


def test_undistorted_places_are_distorted_as_in_opencv():
    rig, K = TrueRig(distortion=[-0.25, 0.08]), np.array([[90.0, 0, 50], [0, 90.0, 30], [0, 0, 1]])
    straight = (rig.undistorted(pixels(), K) - K[:2, 2]) / 90.0
    r2 = (straight**2).sum(axis=1, keepdims=True)
    assert straight * (1 - 0.25 * r2 + 0.08 * r2**2) * 90.0 + K[:2, 2] == pytest.approx(pixels(), abs=1e-6)


def test_a_lens_that_folds_the_image_is_an_error(tmp_path):
    with pytest.raises(SceneError, match="folds the image"):
        dataset(tmp_path, TrueRig(distortion=[-2, 0])).load("facade")


def test_options(tmp_path):
    cfg = config("dataset=synthetic", "dataset.loader.errors.rig.offset=[0.1,0,0]", f"data.root={tmp_path}")
    check_options(cfg)
    assert instantiate(cfg.dataset.loader).errors == CaptureErrors(rig=TrueRig(offset=[0.1, 0, 0]))
    made = config("dataset=synthetic_rig", f"data.root={tmp_path}")
    check_options(made)
    assert instantiate(made.dataset.loader).errors.rig.focal == 1.02
    with pytest.raises(OptionError, match=r"errors\.rig\.offset"):
        check_options(config("dataset=synthetic", "dataset.loader.errors.rig.offset=[0.1,0]"))
