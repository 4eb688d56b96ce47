import dataclasses

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.bench.init import BoxAroundPoints, ColmapPoints, CubeAroundCameras, ReleasedCube, ThermalStereo
from tdgbench.scenes import PointCloud, ReadOptions, SceneError
from tdgbench.scenes.scene import Tracks
from tdgbench.scenes.synthetic import SyntheticDataset
from tests.helpers.configs import config


def test_colmap(small_scene):
    init = ColmapPoints()
    assert init.points(small_scene) is small_scene.points
    description = init.describe(small_scene, small_scene.points)
    assert (description["kind"], description["points"]) == ("colmap", len(small_scene.points.points))
    with pytest.raises(SceneError, match="use init=random"):
        init.points(dataclasses.replace(small_scene, points=None))


def test_points_that_two_training_views_see(small_scene):
    """Point 0 is seen by two training views, point 1 by one of them twice and a test view, point 2 by test views."""
    a, b, *_ = (view.name for view in small_scene.train)
    names = dict(enumerate([a, b, *(view.name for view in small_scene.test[:2])]))
    tracks = Tracks(np.array([0, 0, 1, 1, 1, 2, 2]), np.array([0, 1, 0, 0, 2, 2, 3], np.uint32), names)
    scene = dataclasses.replace(small_scene, points=dataclasses.replace(small_scene.points, tracks=tracks))
    init = ColmapPoints(train_only=True)
    cloud = init.points(scene)
    assert np.array_equal(cloud.points, small_scene.points.points[:1])
    assert f"two training views see, 1 of {len(scene.points.points)}" in init.describe(scene, cloud)["how"]
    with pytest.raises(SceneError, match="have no tracks"):
        init.points(dataclasses.replace(small_scene, points=dataclasses.replace(small_scene.points, tracks=None)))
    none = dataclasses.replace(small_scene.points, tracks=Tracks(tracks.points, tracks.images, {}))
    with pytest.raises(SceneError, match="no two training views"):
        init.points(dataclasses.replace(small_scene, points=none))


@pytest.fixture(scope="module")
def stereo():
    return instantiate(config("init=mvs_thermal", "init.points.width=64", "init.points.planes=32").init.points)


@pytest.fixture(scope="module")
def facade(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes")
    return SyntheticDataset(folder, ReadOptions(), width=96, height=72, views=12, points=40).load("facade")


@pytest.fixture(scope="module")
def cloud(facade, stereo: ThermalStereo) -> PointCloud:
    return stereo.points(facade)


def test_points_of_thermal_images_alone(facade, stereo: ThermalStereo, cloud):
    """The points lie on the surfaces; neither RGB images, sparse points nor test views matter; they are bytes again."""
    assert stereo.describe(facade, cloud)["points"] == len(cloud.points) > 500
    for view in facade.test:  # which the points do not know
        pixels, depths = view.camera.project(cloud.points)
        inside = view.camera.holds(pixels, depths)
        columns, rows = pixels[inside].astype(int).T
        errors = np.abs(depths[inside] / view.true_depth[rows, columns] - 1)
        assert inside.sum() > 200 and np.median(errors) < 0.04
        assert np.median(np.abs(cloud.colors[inside] - view.thermal[rows, columns])) < 0.05
    train = [dataclasses.replace(view, load_rgb=None, load_true_depth=None) for view in facade.train]
    again = stereo.points(dataclasses.replace(facade, points=None, train=train, test=[]))
    assert np.array_equal(again.points, cloud.points) and np.array_equal(again.colors, cloud.colors)


def test_noise_is_averaged_over_neighbouring_pixels(facade, stereo):
    """In noisy images, more depths are confirmed with the penalties than without, and closer to the surfaces."""
    rng = np.random.default_rng(0)
    noise = 0.05 * rng.normal(size=(len(facade.train), *facade.train[0].thermal.shape)).astype(np.float32)
    train = [
        dataclasses.replace(view, load_thermal=lambda image=view.thermal + error: image)
        for view, error in zip(facade.train, noise, strict=True)
    ]
    scene = dataclasses.replace(facade, train=train)
    found = []
    for init in (stereo, dataclasses.replace(stereo, slant=1e-6, jump=1e-6)):
        points = init.points(scene).points
        errors = []
        for view in facade.test:
            pixels, depths = view.camera.project(points)
            inside = view.camera.holds(pixels, depths)
            columns, rows = pixels[inside].astype(int).T
            errors.append(np.abs(depths[inside] / view.true_depth[rows, columns] - 1))
        found.append((len(points), np.median(np.concatenate(errors))))
    (smoothed, error), (alone, larger) = found
    assert smoothed > 1.1 * alone and error < larger


def test_masked_pixels_give_no_points(facade, stereo, cloud):
    """With the left half of all views masked, no point lies in the left half of each of them."""
    half = np.arange(96)[None] >= 48
    masked = [dataclasses.replace(view, load_valid=lambda: np.repeat(half, 72, axis=0)) for view in facade.train]
    scene = dataclasses.replace(facade, train=masked)
    points = stereo.points(scene).points
    shown = [view.camera.project(points)[0][:, 0] >= 48 for view in masked]
    assert 0 < len(points) < len(cloud.points) and np.any(shown, axis=0).mean() > 0.99


def test_views_that_no_other_confirms_give_an_error(facade, stereo):
    with pytest.raises(SceneError, match="agrees with that of 9 others; use"):
        dataclasses.replace(stereo, agreeing=9).points(facade)
    with pytest.raises(SceneError, match="no depth of a thermal training image"):
        dataclasses.replace(stereo, degrees=0.01).points(facade)  # no view has neighbours


def test_random_points_fill_their_cube(small_scene):
    init = CubeAroundCameras(5000, 2.0, seed=0)
    cloud = init.points(small_scene)
    description = init.describe(small_scene, cloud)
    low, high = np.array(description["box"])
    assert "5000 points, uniform in a cube of half side 2 × extent" in description["how"]
    assert np.allclose(high - low, 4 * small_scene.extent)
    assert (cloud.points >= low).all() and (cloud.points <= high).all()
    assert np.allclose(cloud.points.mean(axis=0), (low + high) / 2, atol=0.1 * small_scene.extent)
    assert cloud.colors.shape == (5000, 3) and cloud.colors.min() >= 0 and cloud.colors.max() <= 1
    again, other = (
        CubeAroundCameras(5000, 2.0, 0).points(small_scene),
        CubeAroundCameras(5000, 2.0, 1).points(small_scene),
    )
    assert np.array_equal(cloud.points, again.points) and not np.array_equal(cloud.points, other.points)


def test_the_released_random_points_do_not_depend_on_the_scene(small_scene):
    init = ReleasedCube(2000, seed=0)
    cloud = init.points(small_scene)
    assert np.abs(cloud.points).max() <= 1.3 and np.allclose(np.ptp(cloud.points, axis=0), 2.6, atol=0.02)
    assert np.allclose(cloud.colors, 127 / 255)  # SH2RGB of almost nothing, stored in 8 bits
    assert "±" not in init.kind and init.describe(small_scene, cloud)["box"] == [[-1.3] * 3, [1.3] * 3]


def test_random_points_in_the_box_of_the_sfm_points(small_scene):
    points = np.concatenate([small_scene.points.points, [[1e6, 0, 0]]])  # one outlier
    scene = dataclasses.replace(small_scene, points=dataclasses.replace(small_scene.points, points=points))
    cloud = BoxAroundPoints(2000, seed=0).points(scene)
    assert (cloud.points >= small_scene.points.points.min(axis=0)).all()
    assert (cloud.points <= small_scene.points.points.max(axis=0)).all()
    with pytest.raises(SceneError, match="which init=random_box needs"):
        BoxAroundPoints(10, 0).points(dataclasses.replace(small_scene, points=None))
