import numpy as np
import pytest

from tdgbench.scenes.synthetic.surfaces import (
    Cuboid,
    Cylinder,
    Hills,
    Material,
    Patches,
    Rectangle,
    Sphere,
    Spot,
    Waves,
)

DOWN = np.array([[0.0, 0.0, -1.0]])


@pytest.mark.parametrize(
    ("solid", "height"),
    [(Sphere((0, 0, 1), 0.5), 1.5), (Cuboid((0, 0, 1), (1, 2, 0.25), 0.7), 1.25), (Cylinder((0, 0, 0), 1, 0.75), 0.75),
     (Rectangle((0, 0, 0.5), (1, 0, 0), (0, 1, 0)), 0.5)],
)  # fmt: skip
def test_rays_from_above(solid, height):
    eye, rays = np.array([0.1, 0.1, 5.0]), np.array([[-0.02, -0.02, -1.0]]) * 2
    points = eye + solid.intersect(eye, rays)[:, None] * rays
    (normal,) = solid.normals(points)
    assert points[0, 2] == pytest.approx(height, abs=0.02)
    assert normal[2] > 0.95 and np.linalg.norm(normal) == pytest.approx(1)
    assert np.isinf(solid.intersect(np.array([9.0, 9.0, 5.0]), DOWN)[0])
    assert np.isinf(solid.intersect(np.array([0.0, 0.0, 5.0]), -DOWN)[0])


@pytest.mark.parametrize("solid", [Sphere((0.1, 0.2, 1), 0.5), Cuboid((0, 0.1, 1), (1, 2, 0.25), 0.7),
                                   Cylinder((0.1, 0, 0.2), 1, 0.75)])  # fmt: skip
def test_normals_point_out_of_solids(solid):
    rng = np.random.default_rng(0)
    eye, rays = np.array([4.0, -3.0, 2.5]), rng.normal(size=(20_000, 3))
    t = solid.intersect(eye, rays)
    rays, t = rays[np.isfinite(t)], t[np.isfinite(t)]
    points = eye + t[:, None] * rays
    normals = solid.normals(points)
    assert len(points) > 20 and ((normals * rays).sum(axis=1) < 0).all()
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1)


def test_points_lie_on_their_surfaces():
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(5000, 3))
    cylinder = Cylinder((0.2, 0.1, -0.5), 0.8, 1.0)
    origin = np.array([3.0, 1.0, 1.0])
    t = cylinder.intersect(origin, rays)
    hit = (origin + t[:, None] * rays)[np.isfinite(t)] - np.array(cylinder.base)
    radius = np.linalg.norm(hit[:, :2], axis=1)
    on_side, on_top = np.isclose(radius, 0.8), np.isclose(hit[:, 2], 1.0)
    assert len(hit) > 10 and (on_side | on_top).all() and (radius < 0.8 + 1e-9).all()


def test_rays_meet_hills_on_their_surface():
    hills = Hills(((0.8, 0.4, 0.1, 0.3), (0.5, -0.2, 0.4, 1.0)))
    rng = np.random.default_rng(0)
    rays = np.concatenate([rng.uniform(-0.6, 0.6, (2000, 2)), np.full((2000, 1), -1.0)], axis=1)
    origin = np.array([3.0, -1.0, 20.0])
    points = origin + hills.intersect(origin, rays)[:, None] * rays
    normal, (x, y, z) = hills.normals(points), points.T
    step = 1e-5
    slopes = [(hills.height(x + step * (1 - i), y + step * i)[0] - z) / step for i in range(2)]
    assert np.ptp(z) > 2 and np.abs(z - hills.height(x, y)[0]).max() < 1e-9
    assert -normal[:, :2].T / normal[:, 2] == pytest.approx(np.array(slopes), abs=1e-4)
    assert np.isinf(hills.intersect(origin, -rays)).all()


def test_waves_are_smooth_and_seeded():
    points = np.random.default_rng(0).normal(size=(2000, 3))
    values = Waves(1, 2.0)(points)
    assert values.min() > -0.5 and values.max() < 1.5 and values.std() > 0.1
    assert np.array_equal(values, Waves(1, 2.0)(points)) and not np.array_equal(values, Waves(2, 2.0)(points))
    step = 1e-4
    assert np.abs(Waves(1, 2.0)(points + step) - values).max() < 2 * np.pi * 2.0 * 2 * step * np.sqrt(3)


def test_temperature_adds_up():
    spot = Spot((0, 0, 1), (0.5, 0.5, 0.5), 8.0)
    material = Material((1, 1, 1), (0, 0, 0), Waves(0, 1.0), 20.0, 0.0, 2.0, (spot,))
    _, at = material.shade(np.array([[0.0, 0, 1], [9, 9, 1]]))
    assert at.tolist() == pytest.approx([20 + 2 + 8, 20 + 2])


def test_albedo_lies_between_its_colors():
    material = Material((0.9, 0.5, 0.1), (0.1, 0.2, 0.3), Waves(0, 1.0), 0.0)
    albedo, _ = material.shade(np.random.default_rng(0).normal(size=(100, 3)))
    assert (albedo >= np.array([0.1, 0.2, 0.1]) - 1e-9).all() and (albedo <= np.array([0.9, 0.5, 0.3]) + 1e-9).all()


def test_a_patch_is_of_the_nearest_site_s_material():
    warm, cold = (Material((degC / 30,) * 3, (degC / 30,) * 3, Waves(0, 1.0), degC) for degC in (30.0, 10.0))
    ground = Patches(np.array([[0.0, 0.0], [2.0, 0.0]]), [warm, cold])
    points = np.array([[0.9, 5.0, 1.0], [1.1, -5.0, 0.0], [-8.0, 0.0, 0.0]])
    albedo, degC = ground.shade(points)
    assert degC.tolist() == [30, 10, 30]
    assert albedo[:, 0] == pytest.approx([1, 1 / 3, 1])
