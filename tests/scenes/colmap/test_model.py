import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tdgbench.scenes import Camera, PointCloud, SceneError
from tdgbench.scenes.camera import pose_at
from tdgbench.scenes.colmap import read_model, write_model


def pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return pose_at(rng.normal(size=3), Rotation.random(random_state=seed).as_matrix())


def test_round_trip(tmp_path):
    K = np.array([[100.0, 0, 32.5], [0, 101, 24.25], [0, 0, 1]])
    views = [(f"a/v{i}.png", Camera(K, pose(i), 64, 48)) for i in range(3)]
    cloud = PointCloud(np.random.default_rng(0).normal(size=(9, 3)), np.full((9, 3), 0.2, np.float32))
    write_model(tmp_path / "0", views, cloud)
    posed, points, _ = read_model(tmp_path / "0")
    assert sorted(posed) == ["v0", "v1", "v2"]
    for name, camera in views:
        read = posed[name[2:-4]].camera
        assert np.allclose(read.K, K) and (read.width, read.height) == (64, 48)
        assert np.allclose(read.world_to_camera, camera.world_to_camera, atol=1e-12)
    assert np.allclose(points.points, cloud.points) and np.allclose(points.colors, 0.2)


def test_projection_agrees_with_pycolmap(tmp_path):
    camera = pycolmap.Camera(model="PINHOLE", width=64, height=48, params=[100, 101, 32.5, 24.25], camera_id=1)
    ours = Camera(np.array(camera.calibration_matrix()), pose(3), 64, 48)
    points = ours.center + ours.world_to_camera[:3, :3].T @ np.array([0.1, -0.2, 3.0])
    pixels, z = ours.project(points[None])
    assert z[0] == pytest.approx(3.0)
    assert np.allclose(pixels[0], camera.img_from_cam(np.array([0.1, -0.2, 3.0])))


def test_distorted_cameras_become_pinholes(tmp_path):
    """A straight line in the world is straight after undistortion, and lies where the pinhole projects it."""
    model = pycolmap.Reconstruction()
    params = [80, 80, 60, 45, -0.15, 0.02, 0.001, -0.002]
    distorted = pycolmap.Camera(model="OPENCV", width=120, height=90, params=params, camera_id=1)
    model.add_camera_with_trivial_rig(distorted)
    model.add_image_with_trivial_frame(pycolmap.Image(name="v.png", camera_id=1, image_id=1), pycolmap.Rigid3d())
    model.write_binary(str(tmp_path))
    posed, points, _ = read_model(tmp_path)
    view = posed["v"]
    assert points is None and view.undistortion is not None
    assert view.camera.K[0, 1] == 0 and view.camera.K[0, 0] > 0

    y, x = np.mgrid[0:90, 0:120] + 0.5
    rays = distorted.cam_from_img(np.stack([x.ravel(), y.ravel()], axis=-1))
    image = np.sin(6 * rays[:, 0]).reshape(90, 120, 1).astype(np.float32)  # depends on the ray's x alone
    flat = view.undistortion.apply(image)
    u = np.arange(view.camera.width) + 0.5
    expected = np.sin(6 * (u - view.camera.K[0, 2]) / view.camera.K[0, 0])
    inner = (slice(15, -15), slice(15, -15))
    assert np.abs(flat[..., 0] - expected)[inner].max() < 0.01


def test_unreadable_models_are_refused(tmp_path):
    with pytest.raises(SceneError, match="not a COLMAP model"):
        read_model(tmp_path / "nothing")
    (tmp_path / "cameras.bin").write_bytes(b"x")
    with pytest.raises(SceneError, match="not a COLMAP model"):
        read_model(tmp_path)


@pytest.mark.parametrize("kind", ["binary", "text"])
def test_tracks_say_which_views_see_a_point(tmp_path, kind):
    K = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
    sideways = np.eye(4)
    sideways[0, 3] = -2.0  # the second camera stands two units to the right
    views = [("a.png", Camera(K, np.eye(4), 64, 48)), ("b.png", Camera(K, sideways, 64, 48))]
    points = np.array([[-1.0, 0, 2], [1, 0, 2], [3, 0, 2], [9, 0, 2]])  # seen by a, by both, by b, by none
    write_model(tmp_path, views, PointCloud(points, np.zeros((4, 3), np.float32)), observations=9)
    if kind == "text":
        (model := pycolmap.Reconstruction(str(tmp_path))).write_text(str(tmp_path))
        assert model.num_points3D() == 4
        for path in tmp_path.glob("*.bin"):
            path.unlink()
    cloud = read_model(tmp_path).points
    order = np.argsort(cloud.points[:, 0])
    assert cloud.tracks.views_of_points(4, {"a", "b"})[order].tolist() == [1, 2, 1, 0]
    assert cloud.tracks.views_of_points(4, {"b", "other"})[order].tolist() == [0, 1, 1, 0]


def test_one_model_of_two_modalities(tmp_path):
    """Images of one modality are the views; points are seen by these alone."""
    K = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
    views = [(f"{kind}/{name}.png", Camera(K, pose(seed), 64, 48))
             for seed, (kind, name) in enumerate([("rgb", "a"), ("thermal", "a"), ("rgb", "b")])]  # fmt: skip
    points = views[0][1].center + views[0][1].world_to_camera[:3, :3].T @ np.array([0, 0, 2.0])
    write_model(tmp_path, views, PointCloud(points[None], np.zeros((1, 3), np.float32)), observations=9)
    read = read_model(tmp_path, ("thermal", "rgb"))
    assert list(read.images) == ["a"] and list(read.others) == ["a", "b"] and read.images["a"].key == "thermal/a"
    assert np.allclose(read.images["a"].camera.world_to_camera, pose(1))
    assert np.allclose(read.others["a"].camera.world_to_camera, pose(0))
    seen = [bool(view.shows(points[None])[0]) for _, view in views]
    assert read.points.tracks.views_of_points(1, {"a", "b"}).tolist() == [int(seen[1])] and seen[0]
    assert list(read_model(tmp_path).images) == ["rgb_a", "thermal_a", "rgb_b"]
