import numpy as np
import pytest

from tdgbench.scenes import Camera, SceneError
from tdgbench.scenes.camera import MAX_COORDINATE, check_camera


def camera(**changes) -> Camera:
    K, pose = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), np.eye(4)
    for place, value in changes.get("K", {}).items():
        K[place] = value
    for place, value in changes.get("pose", {}).items():
        pose[place] = value
    return Camera(K, pose, changes.get("width", 64), changes.get("height", 48))


@pytest.mark.parametrize("changes", [{}, {"K": {(0, 2): -20}}, {"pose": {(0, 3): MAX_COORDINATE}}, {"K": {(1, 1): 30}}])
def test_cameras_that_can_be(changes):
    check_camera(camera(**changes), "view v")


@pytest.mark.parametrize(
    "changes",
    [
        {"K": {(0, 0): np.nan}}, {"K": {(0, 0): np.inf}}, {"K": {(0, 0): 0}}, {"K": {(1, 1): -50}},
        {"K": {(0, 0): 0.1, (1, 1): 0.1}}, {"K": {(0, 0): 1e5, (1, 1): 1e5}}, {"K": {(0, 0): 400}},
        {"K": {(0, 2): np.nan}}, {"K": {(1, 2): 1e4}}, {"K": {(0, 1): 3}}, {"K": {(2, 2): 2}},
        {"width": 0}, {"height": -1}, {"width": 10**6, "height": 10**6},
        {"pose": {(0, 0): np.nan}}, {"pose": {(0, 3): -np.inf}}, {"pose": {(0, 0): 0}}, {"pose": {(0, 0): -1}},
        {"pose": {(3, 0): 1}}, {"pose": {(1, 3): 1e12}},
    ],
)  # fmt: skip
def test_cameras_that_cannot_be(changes):
    with pytest.raises(SceneError, match=r"^view v (has|is) .*Correct the model$"):
        check_camera(camera(**changes), "view v")
