from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scenes import Camera, SceneError, View


def camera(centre, size=(40, 30)) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = -np.asarray(centre, float)
    return Camera(np.array([[20.0, 0, 20], [0, 20, 15], [0, 0, 1]]), pose, *size)


def test_camera():
    c = camera([1, 2, 3])
    assert np.allclose(c.center, [1, 2, 3])
    pixels, z = c.project(np.array([[1.0, 2, 5], [2, 2, 5], [1, 2, 1]]))
    assert np.allclose(pixels[:2], [[20, 15], [30, 15]]) and np.allclose(z, [2, 2, -2])


def test_images_are_read_once():
    calls = []

    def read():
        calls.append(1)
        return np.zeros((2, 2, 1), np.float32)

    view = View("v", camera([0, 0, 0]), load_thermal=read)
    assert view.thermal is view.thermal and len(calls) == 1 and view.true_depth is None


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
