from dataclasses import replace

import numpy as np
import pytest

from tdgbench.priors import PriorError
from tdgbench.scenes import Scene
from tests.priors.estimators import correlation, make


@pytest.mark.parametrize(("kind", "sign"), [("depth", 1), ("disparity", -1), ("metric", 1)])
def test_synthetic_is_the_truth_with_errors(small_scene: Scene, kind, sign):
    view = small_scene.train[0]
    prior = make("synthetic", kind=kind).estimate(small_scene, view)
    assert prior.kind == kind and prior.values.dtype == np.float32
    truth = 1 / view.true_depth if kind == "disparity" else view.true_depth
    assert 0.9 < correlation(prior.values, truth) < 0.99999
    error = np.abs(prior.values - view.true_depth).mean()
    assert (error < 0.5) == (kind == "metric")
    assert np.sign(correlation(prior.values, view.true_depth)) == sign


def test_synthetic_depends_on_its_seed(small_scene):
    view = small_scene.train[0]
    a, b, c = (make("synthetic", seed=s).estimate(small_scene, view).values for s in (0, 0, 1))
    assert np.array_equal(a, b) and not np.array_equal(a, c)


def test_other_scenes_have_no_true_depth(small_scene):
    view = replace(small_scene.train[0], load_true_depth=None)
    with pytest.raises(PriorError, match="has no true depth; prior=synthetic is for the synthetic scenes"):
        make("synthetic").estimate(small_scene, view)
