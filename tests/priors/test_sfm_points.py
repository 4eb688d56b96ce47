import numpy as np
import pytest
from omegaconf import OmegaConf

from tdgbench.priors import PriorError, known_depth
from tdgbench.priors.sfm_points import GRID, POINTS_IN_WINDOW, WINDOW, grid_width, visible_points
from tdgbench.resources import conf_folder
from tdgbench.scenes import Camera
from tests.helpers.scenes import small_dataset
from tests.priors.estimators import correlation, make


@pytest.mark.parametrize("name", ["orbit", "facade"])
def test_sfm_points_find_the_depth(data_root, name):

    scene = small_dataset(data_root).load(name)
    for view in scene.train[:3]:
        prior = make("sfm_points").estimate(scene, view)
        assert prior.kind == "disparity" and np.isfinite(prior.values).all()
        assert correlation(prior.values, 1 / view.true_depth) > 0.8


def test_options_that_leave_no_finite_depth_are_an_error(small_gray_scene):
    with pytest.raises(PriorError, match=r"smoothness=1e-310 .* view001 of turntable no finite depth; raise them"):
        make("sfm_points", smoothness=1e-310).estimate(small_gray_scene, small_gray_scene.train[0])


def test_known_depth_hides_points_as_the_prior_does():
    options = OmegaConf.load(conf_folder() / "prior" / "sfm_points.yaml").estimator
    assert (options.grid_width, options.occlusion) == (known_depth.GRID_WIDTH, known_depth._OCCLUSION)


def test_near_points_hide_far_ones_beside_them():
    camera = Camera(np.diag([10.0, 10.0, 1.0]), np.eye(4), width=20, height=20)
    near, beside, far_away, behind = [0.5, 0.5, 1.0], [1.2, 1.0, 2.0], [3.0, 3.0, 2.0], [0.5, 0.5, -1.0]
    seen = visible_points(camera, np.array([near, beside, far_away, behind, [5.0, 0.5, 1.0]]), 0.1)
    assert seen.number.tolist() == [0, 2]
    assert (seen.rows.tolist(), seen.columns.tolist(), seen.z.tolist()) == ([5, 15], [5, 15], [1.0, 2.0])
    assert visible_points(camera, np.array([near, beside]), 1.0).number.tolist() == [0, 1]
    assert len(visible_points(camera, np.array([behind]), 0.1).z) == 0


def test_a_grid_has_a_few_points_in_each_window():
    camera = Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), width=100, height=100)
    points = np.concatenate([np.random.default_rng(0).random((576, 2)), np.ones((576, 1))], axis=1)
    behind = points * [1, 1, -1]
    width = grid_width([camera], np.concatenate([points, behind]))
    assert abs(WINDOW**2 * 576 / width**2 - POINTS_IN_WINDOW) < 0.2
    assert grid_width([camera, camera], points) == width
    assert (grid_width([camera], points[:1]), grid_width([camera], np.tile(points, (100, 1)))) == GRID
