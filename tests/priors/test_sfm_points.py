import dataclasses

import numpy as np
import pytest

from tdgbench.priors import PriorError
from tests.helpers.scenes import small_dataset
from tests.priors.estimators import correlation, make


@pytest.mark.parametrize("name", ["orbit", "facade"])
def test_sfm_points_find_the_depth(data_root, name):

    scene = small_dataset(data_root).load(name)
    for view in scene.train[:3]:
        prior = make("sfm_points").estimate(scene, view)
        assert prior.kind == "disparity" and np.isfinite(prior.values).all()
        assert correlation(prior.values, 1 / view.true_depth) > 0.8


def test_sfm_points_need_points(small_scene):
    bare = dataclasses.replace(small_scene, points=None)
    with pytest.raises(PriorError, match="needs a COLMAP model with points"):
        make("sfm_points").estimate(bare, small_scene.train[0])
