from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scenes import Camera, SceneError, View
from tdgbench.scenes.camera import MAX_COORDINATE, check_camera


def camera(centre, size=(40, 30)) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = -np.asarray(centre, float)
    return Camera(np.array([[20.0, 0, 20], [0, 20, 15], [0, 0, 1]]), pose, *size)


def test_a_masked_pixel_is_0_whatever_was_read():
    image = np.array([[[np.nan], [0.5]], [[1e30], [0.25]]], np.float32)
    valid = np.array([[False, True], [False, True]])
    view = View("v", camera([0, 0, 0], (2, 2)), load_thermal=lambda: image, load_valid=lambda: valid)
    assert view.thermal[..., 0].tolist() == [[0.0, 0.5], [0.0, 0.25]] and view.thermal.dtype == np.float32
    whole = replace(view, load_valid=lambda: np.ones((2, 2), bool))
    assert whole.valid is None and whole.thermal is image  # nothing is masked


@pytest.mark.parametrize("mask", [np.ones((2, 3), bool), np.ones((2, 2), np.uint8)], ids=["size", "type"])
def test_a_mask_must_be_bool_and_of_the_camera_s_size(mask):
    view = View("v7", camera([0, 0, 0], (2, 2)), load_thermal=lambda: None, load_valid=lambda: mask)
    with pytest.raises(SceneError, match=r"the mask of view v7 is .*must be bool \(2, 2\)"):
        _ = view.valid


def test_another_thermal_image_keeps_what_was_read_besides():
    reads = []

    def read(name, image):
        return lambda: reads.append(name) or image

    valid = np.array([[True, False], [True, True]])
    rgb = np.zeros((2, 2, 3), np.float32)
    view = View(
        "v", camera([0, 0, 0], (2, 2)), read("thermal", np.ones((2, 2, 1), np.float32)), read("rgb", rgb),
        load_valid=read("valid", valid),
    )  # fmt: skip
    assert view.thermal.sum() == 3 and view.rgb is rgb
    other = view.with_thermal(np.full((2, 2, 1), 0.5, np.float32))
    assert other.thermal[0].ravel().tolist() == [0.5, 0.0] and other.rgb is rgb and view.thermal.sum() == 3
    assert sorted(reads) == ["rgb", "thermal", "valid"]
    unread = replace(view).with_thermal(view.thermal)  # nothing was read of this one
    assert unread.rgb is rgb and reads[3:] == ["rgb"]


def changed_camera(**changes) -> Camera:
    K, pose = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), np.eye(4)
    for place, value in changes.get("K", {}).items():
        K[place] = value
    for place, value in changes.get("pose", {}).items():
        pose[place] = value
    return Camera(K, pose, changes.get("width", 64), changes.get("height", 48))


@pytest.mark.parametrize("changes", [{}, {"K": {(0, 2): -20}}, {"pose": {(0, 3): MAX_COORDINATE}}, {"K": {(1, 1): 30}}])
def test_cameras_that_can_be(changes):
    check_camera(changed_camera(**changes), "view v")


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
        check_camera(changed_camera(**changes), "view v")
