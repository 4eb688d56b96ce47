import numpy as np
import pytest

from tdgbench.scenes.synthetic.render import shade, trace
from tdgbench.scenes.synthetic.surfaces import Cuboid, Cylinder, Hills, Material, Patches, Sphere, Spot
from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.helpers.scenes import small_dataset

DOWN = np.array([[0.0, 0.0, -1.0]])


def hit(solid, origin, rays):
    """t (N,) of the hits, NaN where a ray misses."""
    with np.errstate(all="ignore"):
        t = solid.intersect(np.array(origin), rays)
    return np.where((t > 0) & np.isfinite(t), t, np.nan)


@pytest.mark.parametrize(
    ("solid", "distance"),  # of local points from the surface
    [(Sphere((0.1, 0.2, 1), 0.5), lambda p: np.linalg.norm(p - [0.1, 0.2, 1], axis=1) - 0.5),
     (Cuboid((0, 0.1, 1), (1, 2, 0.25)), lambda p: (np.abs(p - [0, 0.1, 1]) - [1, 2, 0.25]).max(axis=1)),
     (Cylinder((0.1, 0, 0.2), 1, 0.75),
      lambda p: np.maximum(np.hypot(p[:, 0] - 0.1, p[:, 1]) - 1, np.abs(p[:, 2] - 0.575) - 0.375))],
)  # fmt: skip
def test_hits_lie_on_the_surface_whose_normals_point_out(solid, distance):
    eye, rays = np.array([4.0, -3.0, 2.5]), np.random.default_rng(0).normal(size=(20_000, 3))
    t = hit(solid, eye, rays)
    rays, t = rays[np.isfinite(t)], t[np.isfinite(t)]
    points = eye + t[:, None] * rays
    normals = solid.normals(points)
    assert len(points) > 20 and np.abs(distance(points)).max() < 1e-9
    assert ((normals * rays).sum(axis=1) < 0).all() and np.linalg.norm(normals, axis=1) == pytest.approx(1)
    assert distance(points + 1e-3 * normals) == pytest.approx(1e-3)
    assert (distance(eye + 0.99 * t[:, None] * rays) > 0).all()


def test_rays_meet_hills_on_their_surface():
    hills = Hills(np.array([[0.8, 0.5], [0.4, -0.2], [0.1, 0.4], [0.3, 1.0]]))
    rng = np.random.default_rng(0)
    rays = np.concatenate([rng.uniform(-0.6, 0.6, (2000, 2)), np.full((2000, 1), -1.0)], axis=1)
    origin = np.array([3.0, -1.0, 20.0])
    x, y, z = (origin + hit(hills, origin, rays)[:, None] * rays).T
    expected = 0.8 * np.sin(0.4 * x + 0.1 * y + 0.3) + 0.5 * np.sin(-0.2 * x + 0.4 * y + 1)
    slopes = [(hills.height(x + 1e-5 * (1 - i), y + 1e-5 * i)[0] - z) / 1e-5 for i in range(2)]
    normal = hills.normals(np.stack([x, y, z], axis=1))
    assert np.ptp(z) > 2 and np.abs(z - expected).max() < 1e-9
    assert -normal[:, :2].T / normal[:, 2] == pytest.approx(np.array(slopes), abs=1e-4)


def test_a_material_mixes_its_colours_and_adds_its_temperatures_up():
    material = Material(((0.9, 0.5, 0.1), (0.1, 0.2, 0.3)), 0, 1.0, 20.0, 0.0, 2.0, (Spot((0, 0, 1), (0.5,) * 3, 8.0),))
    albedo, degC = material.shade(np.array([[0.0, 0, 1], [9, 9, 1], [0.5, 0, 1]]))
    assert degC == pytest.approx([20 + 2 + 8, 20 + 2, 22 + 8 * np.exp(-0.5)])
    mix = (albedo - [0.1, 0.2, 0.3]) / [0.8, 0.3, -0.2]  # the same in all channels
    assert np.ptp(mix, axis=1) == pytest.approx(0) and mix.min() >= 0 and mix.max() <= 1


def test_a_patch_is_of_the_nearest_site_s_material():
    warm, cold = (Material(((degC / 30,) * 3, (degC / 30,) * 3), 0, 1.0, degC) for degC in (30.0, 10.0))
    ground = Patches(np.array([[0.0, 0.0], [2.0, 0.0]]), [warm, cold])
    albedo, degC = ground.shade(np.array([[0.9, 5.0, 1.0], [1.1, -5.0, 0.0], [-8.0, 0.0, 0.0]]))
    assert degC.tolist() == [30, 10, 30] and albedo[:, 0] == pytest.approx([1, 1 / 3, 1])


def test_temperatures_are_in_the_image(data_root):
    """Gray values are the cast temperatures, up to noise and rounding."""
    scene = small_dataset(data_root).load("facade")
    world, view = WORLDS["facade"](0), scene.train[3]
    y, x = np.mgrid[0:36, 0:48] + 0.5
    points, depth, owner = trace(world, view.camera, np.stack([x.ravel(), y.ravel()], axis=-1))
    pixels, z = view.camera.project(points)
    assert np.allclose(pixels, np.stack([x.ravel(), y.ravel()], axis=-1)) and np.allclose(z, depth)
    assert np.allclose(depth.reshape(36, 48), view.true_depth, rtol=1e-5)
    _, degC = shade(world, points, owner)
    low, high = scene.temperature.min, scene.temperature.max
    assert np.median(np.abs(view.thermal[..., 0] * (high - low) + low - degC.reshape(36, 48))) < 0.2
