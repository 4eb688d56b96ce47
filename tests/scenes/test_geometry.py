"""Doubts of cameras and points, outliers, and the origin: on scenes that are right, and with one thing changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tdgbench.bench.init import CubeAroundCameras
from tdgbench.scenes import Camera, PointCloud, Scene, View
from tdgbench.scenes.camera import pose_at
from tdgbench.scenes.geometry import MAX_ERROR, doubts_of, near_origin, pixel_errors
from tdgbench.scenes.outliers import outlying, sight_of

FORWARD = np.eye(3)
BACK = np.diag([-1.0, 1.0, -1.0])  # about the vertical


def camera(position, rotation=FORWARD, focal=150.0, size=(160, 120)) -> Camera:
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return Camera(K, pose_at(np.asarray(position, float), rotation), *size)


def scene_of(cameras, points) -> Scene:
    views = [View(f"v{number:04}", one, lambda: np.zeros((1, 1, 1), np.float32)) for number, one in enumerate(cameras)]
    cloud = None if points is None else PointCloud(points, np.zeros((len(points), 3), np.float32))
    return Scene("s", "d", "g", views, [], cloud, None, "", "", 1)


def wall(count=4000, z=3.0) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.stack([*rng.uniform(-2, 2, (2, count)), np.full(count, z)], axis=1)


def row(count=40, **options) -> list[Camera]:
    return [camera([x, 0, 0], **options) for x in np.linspace(-1, 1, count)]


def test_right_scenes_have_no_doubt_and_stay(small_scene, small_gray_scene):
    for scene in (small_scene, small_gray_scene, scene_of(row(), wall()), scene_of(row(), None)):
        assert doubts_of(scene) == [] and not scene.outliers and near_origin(scene) is scene
        centers = np.array([view.camera.center for view in scene.train])
        assert scene.extent == 1.1 * np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()


@pytest.mark.parametrize("points", [wall(), None], ids=["points", "poses alone"])
def test_a_camera_far_away_is_named_and_counts_in_no_extent(points):
    cameras = row()
    scene = scene_of([*cameras[:7], camera([2000, 0, 0]), *cameras[7:]], points)
    assert scene.outliers == {"v0007"}
    (doubt,) = doubts_of(scene)
    assert doubt.startswith("view v0007: the camera stands 2000 from the middle")
    right = scene_of(cameras, points)
    assert scene.extent == right.extent == pytest.approx(1.1)
    assert np.array_equal(*(CubeAroundCameras(9, 3, 0).box(one) for one in (scene, right)))


def test_what_real_captures_have_is_not_outlying():
    points = wall()
    flight = [camera([x, 0, 0]) for x in range(1000)]
    walk = [*row(200), *(camera([10 * k, 0, 0]) for k in range(9))]
    overview = [*row(), camera([0, 0, -60])]
    apart, their_points = [camera([100 + x, 0, 0]) for x in (0, 0.1, 0.2)], wall() + np.array([100, 0, 0])
    for cameras, seen in ((flight, None), (walk, None), (overview, points), (row()[:4], None)):
        assert not outlying(cameras, seen).any()
    assert not outlying([*row(), *apart], np.concatenate([points, their_points])).any()
    assert outlying([*row(), *apart], points).sum() == 3
    assert outlying([*row(), camera([0, 0, -3000])], points).nonzero()[0].tolist() == [40]  # all is a dot


def test_lost_points_are_counted():
    points = wall(200_000)
    points[::20] = np.random.default_rng(1).normal(size=(10_000, 3)) * 1e5
    (doubt,) = doubts_of(scene_of(row(), points))
    assert doubt.startswith("about 5% of the 200000 sparse points lie behind all cameras") and "init=random" in doubt
    points[::20] = wall(10_000, z=-3.0)
    assert "behind all" in doubts_of(scene_of(row(), points))[0]
    points[::20] = wall(10_000, z=1500.0)  # as hills behind a house
    assert doubts_of(scene_of(row(), points)) == []


@pytest.mark.parametrize(
    ("focal", "said"), [(3.8, "175°, which lenses do not have; is it in mm?"), (4000, "larger image")]
)
def test_focal_lengths_that_no_lens_has(focal, said):
    (doubt,) = doubts_of(scene_of(row(focal=focal), None))
    assert doubt.startswith(f"view v0000 and 39 more: the focal length is {focal:g} px for 160 px") and said in doubt


def test_cameras_of_several_kinds_are_named():
    large = [camera([0, 0.1, 0], size=(320, 240), focal=300), camera([0, 0.2, 0], size=(320, 240), focal=300)]
    (doubt,) = doubts_of(scene_of([*row(), *large], wall()))
    assert doubt.startswith(
        "view v0040 and 1 more: 320×240 px, most others 160×120 px, with the same field of view: an"
    )
    (doubt,) = doubts_of(scene_of([*row(), camera([0, 0.1, 0], focal=200)], wall()))
    assert doubt.startswith("cameras of 2 kinds (view v0000 and 39 more: 160×120 px, focal length 150 px; view v0040: ")
    assert "view v0040: 160×120 px, focal length 200 px" in doubt
    upright = camera([0, 0.1, 0], size=(120, 160))
    one_by_one = [camera([x, 0, 0], focal=150 * (1 + 0.04 * np.sin(40 * x)), size=(160, 119)) for x in (0, 0.1, 0.2)]
    assert doubts_of(scene_of([*row(), upright, *one_by_one], wall())) == []


def test_views_that_see_no_point():
    (doubt,) = doubts_of(scene_of([*row(), camera([0, 0.1, 0], BACK)], wall()))
    assert doubt == "view v0040: none of the 4000 sparse points lies in the image; correct their poses"
    (doubt, _) = doubts_of(scene_of(row(rotation=BACK), wall()))
    assert doubt.startswith("view v0000 and 39 more: none of") and "of one world and one convention of axes" in doubt


def in_float32(scene: Scene) -> float:
    """How far float32 moves the points of a scene in its first view, px."""
    (points, one) = scene.points.points, scene.train[0].camera
    narrow = replace(one, world_to_camera=one.world_to_camera.astype(np.float32), K=one.K.astype(np.float32))
    return float(np.abs(narrow.project(points.astype(np.float32))[0] - one.project(points)[0]).max())


def test_an_origin_far_away_is_moved_between_the_cameras():
    offset = np.array([451_234.5, 5_276_543.25, 312.0])
    right = scene_of(row(), wall())
    far = scene_of([camera(one.center + offset) for one in row()], wall() + offset)
    error = pixel_errors([far.train[0].camera], sight_of([far.train[0].camera], far.points.points))[0]
    assert error == pytest.approx(0.5 * 150 / 3) and 0.2 < in_float32(far) / error < 2
    moved = near_origin(far)
    assert moved.origin == (451_234.0, 5_276_543.0, 312.0) and "float32" in moved.assumed["origin"]
    assert in_float32(moved) < MAX_ERROR and doubts_of(moved) == [] and near_origin(moved) is moved
    assert moved.extent == pytest.approx(right.extent, abs=1e-8)
    for one, other in zip(moved.train, right.train, strict=True):
        shown, expected = (view.camera.project(s.points.points)[0] for view, s in ((one, moved), (other, right)))
        assert np.allclose(shown, expected, atol=1e-5)


def test_scenes_that_are_too_large_for_float32_are_doubted():
    cameras = [camera([1e4 * number, 0, 0]) for number in range(20)]
    points = np.concatenate([wall(100) + one.center for one in cameras])
    moved = near_origin(scene_of(cameras, points))
    assert moved.origin == (0, 0, 0)  # that would be no help
    (doubt,) = doubts_of(moved)
    assert doubt.startswith("view v0014: float32") and "by 0.8 px" in doubt  # one step at 140 km is 1/64
