import dataclasses

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.bench.init import BoxAroundPoints, ColmapPoints, CubeAroundCameras, ReleasedCube
from tdgbench.scenes import SceneError
from tests.helpers.configs import config


def test_colmap(small_scene):
    init = ColmapPoints()
    assert init.points(small_scene) is small_scene.points
    description = init.describe(small_scene)
    assert (description["kind"], description["points"]) == ("colmap", len(small_scene.points.points))
    with pytest.raises(SceneError, match="use init=random"):
        init.points(dataclasses.replace(small_scene, points=None))


def test_random_points_fill_their_cube(small_scene):
    init = CubeAroundCameras(5000, 2.0, seed=0)
    cloud = init.points(small_scene)
    low, high = np.array(init.describe(small_scene)["box"])
    assert "5000 points, uniform in a cube of half side 2 × extent" in init.describe(small_scene)["how"]
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
    assert "±" not in init.kind and init.describe(small_scene)["box"] == [[-1.3] * 3, [1.3] * 3]


def test_random_points_in_the_box_of_the_sfm_points(small_scene):
    points = np.concatenate([small_scene.points.points, [[1e6, 0, 0]]])  # one outlier
    scene = dataclasses.replace(small_scene, points=dataclasses.replace(small_scene.points, points=points))
    cloud = BoxAroundPoints(2000, seed=0).points(scene)
    assert (cloud.points >= small_scene.points.points.min(axis=0)).all()
    assert (cloud.points <= small_scene.points.points.max(axis=0)).all()
    with pytest.raises(SceneError, match="which init=random_box needs"):
        BoxAroundPoints(10, 0).points(dataclasses.replace(small_scene, points=None))


@pytest.mark.parametrize("name", ["random", "random_released", "random_box"])
def test_every_kind_of_random_points_has_a_configuration(small_scene, name):
    cloud = instantiate(config(f"init={name}", "init.points.count=50").init.points).points(small_scene)
    assert cloud.points.shape == (50, 3) and cloud.colors.dtype == np.float32
