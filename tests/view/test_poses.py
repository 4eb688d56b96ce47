"""viser's poses and the scenes' cameras are the same cameras."""

from __future__ import annotations

import numpy as np
import pytest

from tdgbench.scenes import Camera
from tdgbench.view.poses import MAX_PIXELS, ViserPose, camera_of, focus, picture_size, pose_of, up_direction


def test_a_camera_survives_the_way_to_a_pose_and_back(small_scene):
    for view in small_scene.views:
        camera = view.camera
        again = camera_of(pose_of(camera, camera.width / camera.height), camera.width, camera.height)
        assert np.allclose(again.K, camera.K, rtol=1e-9)
        assert np.allclose(again.world_to_camera, camera.world_to_camera, atol=1e-12)


def test_poses_are_those_of_viser():
    """The same rotation, in viser's own terms: R of `P_world = [R | t] p_camera`."""
    transforms = pytest.importorskip("viser.transforms")
    wxyz, position = np.array([0.5, 0.1, -0.7, 0.5]) / np.linalg.norm([0.5, 0.1, -0.7, 0.5]), np.array([1.0, 2, 3])
    to_world = np.linalg.inv(camera_of(ViserPose(wxyz, position, 1.0), 64, 48).world_to_camera)
    pose = transforms.SE3.from_rotation_and_translation(transforms.SO3(wxyz), position)
    assert np.allclose(to_world, pose.as_matrix())


@pytest.mark.parametrize("fov", [-1.0, 0, 1e-300, np.pi, 7])
def test_every_field_of_view_is_one_of_a_pinhole(fov):
    K = camera_of(ViserPose(np.array([1.0, 0, 0, 0]), np.zeros(3), fov), 64, 48).K
    assert np.isfinite(K).all() and 1e-3 < K[0, 0] < 1e6


def test_pictures_have_no_more_pixels_than_a_large_screen():
    width, height = picture_size(60_000, 60_000, 8192)
    assert width == height == round(MAX_PIXELS**0.5)
    assert picture_size(1080, 1920, 1280) == (720, 1280) and picture_size(60_000, 1, 1280) == (1280, 1)


@pytest.mark.parametrize("aspect", [0.5, 4 / 3, 3.0])
def test_the_whole_image_is_in_the_window(small_scene, aspect):
    """Also of a camera whose principal point is off the middle."""
    camera = small_scene.test[0].camera
    shifted = Camera(
        camera.K + np.array([[0, 0, 7], [0, 0, -4], [0, 0, 0]]), camera.world_to_camera, camera.width, camera.height
    )
    corners = np.array([[x, y, 1.0] for x in (0, camera.width) for y in (0, camera.height)])
    rays = corners @ np.linalg.inv(shifted.K).T
    points = (rays - shifted.world_to_camera[:3, 3]) @ shifted.world_to_camera[:3, :3]
    height = 900
    window = camera_of(pose_of(shifted, aspect), round(aspect * height), height)
    pixels, _ = window.project(points)
    assert (pixels > -1e-6).all() and (pixels < [window.width + 1e-6, window.height + 1e-6]).all()
    touched = np.isclose(pixels, 0, atol=1) | np.isclose(pixels, [window.width, window.height], atol=1)
    assert touched.any()  # no larger than needed


def test_the_focus_is_what_all_cameras_look_at():
    point = np.array([1.0, -2, 3])
    cameras = []
    for forward in np.eye(3):
        rotation = np.stack([np.roll(forward, 1), np.roll(forward, 2), forward])
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3], world_to_camera[:3, 3] = rotation, -rotation @ (point - 4 * forward)
        cameras.append(Camera(np.eye(3), world_to_camera, 8, 8))
    assert np.allclose(focus(cameras), point)
    assert np.allclose(focus(cameras[:1]), point - 3 * np.eye(3)[0])  # parallel axes: one unit ahead


def test_up_is_where_the_images_top_is(small_scene):
    up = up_direction(view.camera for view in small_scene.views)
    assert np.isclose(np.linalg.norm(up), 1) and up[2] > 0.7  # synthetic scenes: z up
    flipped = Camera(np.eye(3), np.diag([1.0, -1, -1, 1]), 8, 8)
    assert np.allclose(up_direction([Camera(np.eye(3), np.eye(4), 8, 8), flipped]), [0, 0, 1])
