import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from tdgbench.scenes import Camera, ReadOptions, SceneError
from tdgbench.scenes.synthetic import SyntheticDataset
from tdgbench.scenes.synthetic.raycast import Box, Cylinder, Rectangle, Sphere
from tdgbench.scenes.synthetic.render import cast, look_at
from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.conftest import small_dataset

DOWN = np.array([[0.0, 0.0, -1.0]])


@pytest.mark.parametrize(
    ("solid", "height"),
    [(Sphere((0, 0, 1), 0.5), 1.5), (Box((0, 0, 1), (1, 2, 0.25), 0.7), 1.25), (Cylinder((0, 0, 0), 1, 0.75), 0.75),
     (Rectangle((0, 0, 0.5), (1, 0, 0), (0, 1, 0)), 0.5)],
)  # fmt: skip
def test_seen_from_above(solid, height):
    t, normal = solid.intersect(np.array([0.1, 0.1, 5.0]), np.array([[-0.02, -0.02, -1.0]]) * 2)
    hit = 5.0 - 2 * t[0]
    assert hit == pytest.approx(height, abs=0.02)
    assert normal[0, 2] > 0.95 and np.linalg.norm(normal[0]) == pytest.approx(1)
    missed, _ = solid.intersect(np.array([9.0, 9.0, 5.0]), DOWN)
    assert np.isinf(missed[0])
    behind, _ = solid.intersect(np.array([0.0, 0.0, 5.0]), -DOWN)
    assert np.isinf(behind[0])


def test_points_lie_on_their_surfaces():
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(5000, 3))
    cylinder = Cylinder((0.2, 0.1, -0.5), 0.8, 1.0)
    origin = np.array([3.0, 1.0, 1.0])
    t, _ = cylinder.intersect(origin, rays)
    hit = (origin + t[:, None] * rays)[np.isfinite(t)] - np.array(cylinder.base)
    radius = np.linalg.norm(hit[:, :2], axis=1)
    on_side, on_top = np.isclose(radius, 0.8), np.isclose(hit[:, 2], 1.0)
    assert len(hit) > 10 and (on_side | on_top).all() and (radius < 0.8 + 1e-9).all()


@pytest.mark.parametrize("name", WORLDS)
def test_depth_agrees_with_the_sparse_points(data_root, name):
    """Points, projected into a view, are at its depth there or hidden: cameras, depth and model agree."""
    scene = small_dataset(data_root).load(name)
    for view in scene.views[::4]:
        pixels, z = view.camera.project(scene.points.points)
        inside = (z > 0) & (pixels >= 1).all(axis=1) & (pixels[:, 0] < 47) & (pixels[:, 1] < 35)
        columns, rows = pixels[inside].astype(int).T
        near, far = minimum_filter(view.true_depth, 3)[rows, columns], maximum_filter(view.true_depth, 3)[rows, columns]
        assert (z[inside] > near * 0.97).mean() > 0.95  # nothing floats before the surfaces, but for outliers
        assert ((z[inside] > near * 0.97) & (z[inside] < far * 1.03)).mean() > 0.5


def test_temperatures_are_in_the_image(data_root):
    """Gray values are the cast temperatures, up to noise and rounding."""
    scene = small_dataset(data_root).load("facade")
    world, view = WORLDS["facade"](0), scene.train[3]
    y, x = np.mgrid[0:36, 0:48] + 0.5
    _, degC, depth = cast(world, view.camera, np.stack([x.ravel(), y.ravel()], axis=-1))
    assert np.allclose(depth.reshape(36, 48), view.true_depth, rtol=1e-5)
    low, high = scene.temperature.min, scene.temperature.max
    seen = view.thermal[..., 0] * (high - low) + low
    assert np.median(np.abs(seen - degC.reshape(36, 48))) < 0.2


def test_groups_stand_for_the_paper_s(data_root):
    scenes = {name: small_dataset(data_root).load(name) for name in WORLDS}
    assert {s.group for s in scenes.values()} == {"day", "dark", "360", "forward"}
    assert {n: s.channels for n, s in scenes.items()} == {"orbit": 3, "night": 3, "turntable": 1, "facade": 1}
    brightness = {n: s.train[0].rgb.mean() for n, s in scenes.items()}
    assert brightness["night"] < 0.05 < brightness["orbit"]


def test_same_seed_same_files(tmp_path):
    options = {"width": 24, "height": 18, "views": 5, "points": 50}
    first = SyntheticDataset(str(tmp_path / "a"), ReadOptions(), **options).load("night")
    again = SyntheticDataset(str(tmp_path / "b"), ReadOptions(), **options).load("night")
    other = SyntheticDataset(str(tmp_path / "c"), ReadOptions(), **options, seed=1).load("night")
    assert first.fingerprint == again.fingerprint != other.fingerprint


def test_look_at():
    pose = look_at(np.array([1.0, 2.0, 3.0]), np.array([1.0, 5.0, 3.0]))
    camera = Camera(np.eye(3), pose, 1, 1)
    assert np.allclose(camera.center, [1, 2, 3]) and np.allclose(pose[2, :3], [0, 1, 0])
    assert np.allclose(pose[:3, :3] @ [0, 0, 1], [0, -1, 0])  # up in the world is up in the image


def test_unknown_scene(tmp_path):
    with pytest.raises(SceneError, match="no synthetic scene moon"):
        SyntheticDataset(str(tmp_path), ReadOptions()).load("moon")
