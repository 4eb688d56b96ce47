import numpy as np

from tdgbench.priors.visible import visible_points
from tdgbench.scenes import Camera


def test_near_points_hide_far_ones_beside_them():
    camera = Camera(np.diag([10.0, 10.0, 1.0]), np.eye(4), width=20, height=20)
    near, beside, far_away, behind = [0.5, 0.5, 1.0], [1.2, 1.0, 2.0], [3.0, 3.0, 2.0], [0.5, 0.5, -1.0]
    seen = visible_points(camera, np.array([near, beside, far_away, behind, [5.0, 0.5, 1.0]]), 0.1)
    assert seen.number.tolist() == [0, 2]
    assert (seen.rows.tolist(), seen.columns.tolist(), seen.z.tolist()) == ([5, 15], [5, 15], [1.0, 2.0])
    assert visible_points(camera, np.array([near, beside]), 1.0).number.tolist() == [0, 1]
    assert len(visible_points(camera, np.array([behind]), 0.1).z) == 0
