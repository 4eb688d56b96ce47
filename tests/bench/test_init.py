import dataclasses

import numpy as np
import pytest

from tdgbench.bench.init import ColmapPoints, RandomPoints
from tdgbench.scenes import SceneError


def test_colmap(small_scene):
    init = ColmapPoints()
    assert init.points(small_scene) is small_scene.points
    said = init.describe(small_scene)
    assert (said["kind"], said["points"]) == ("colmap", len(small_scene.points.points))
    with pytest.raises(SceneError, match="use init=random"):
        init.points(dataclasses.replace(small_scene, points=None))


def test_random_points_fill_their_cube(small_scene):
    init = RandomPoints(5000, 2.0, seed=0)
    cloud = init.points(small_scene)
    low, high = np.array(init.describe(small_scene)["box"])
    assert "5000 points, uniform in a cube of half side 2 × extent" in init.describe(small_scene)["how"]
    assert np.allclose(high - low, 4 * small_scene.extent)
    assert (cloud.points >= low).all() and (cloud.points <= high).all()
    assert np.allclose(cloud.points.mean(axis=0), (low + high) / 2, atol=0.1 * small_scene.extent)
    assert cloud.colors.shape == (5000, 3) and cloud.colors.min() >= 0 and cloud.colors.max() <= 1
    again, other = RandomPoints(5000, 2.0, 0).points(small_scene), RandomPoints(5000, 2.0, 1).points(small_scene)
    assert np.array_equal(cloud.points, again.points) and not np.array_equal(cloud.points, other.points)
    with pytest.raises(ValueError, match="count ≥ 1"):
        RandomPoints(0, 1.0, 0)
