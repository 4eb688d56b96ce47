import numpy as np
import pytest

from tdgbench.scenes.synthetic.materials import Material, Patches, Spot, Waves


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
    at = material.temperature(np.array([[0.0, 0, 1], [9, 9, 1]]))
    assert at.tolist() == pytest.approx([20 + 2 + 8, 20 + 2])


def test_albedo_lies_between_its_colors():
    material = Material((0.9, 0.5, 0.1), (0.1, 0.2, 0.3), Waves(0, 1.0), 0.0)
    albedo = material.albedo(np.random.default_rng(0).normal(size=(100, 3)))
    assert (albedo >= np.array([0.1, 0.2, 0.1]) - 1e-9).all() and (albedo <= np.array([0.9, 0.5, 0.3]) + 1e-9).all()


def test_a_patch_is_of_the_nearest_site_s_material():
    warm, cold = (Material((degC / 30,) * 3, (degC / 30,) * 3, Waves(0, 1.0), degC) for degC in (30.0, 10.0))
    ground = Patches(np.array([[0.0, 0.0], [2.0, 0.0]]), [warm, cold])
    points = np.array([[0.9, 5.0, 1.0], [1.1, -5.0, 0.0], [-8.0, 0.0, 0.0]])
    assert ground.temperature(points).tolist() == [30, 10, 30]
    assert ground.albedo(points)[:, 0] == pytest.approx([1, 1 / 3, 1])
