import numpy as np
import pytest

from tdgbench.experiments.measure.ceiling import Comparison, ExpectedValues, true_ceiling
from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset
from tdgbench.scenes.synthetic.thermal_files import thermal_image
from tdgbench.scenes.synthetic.worlds import WORLDS


@pytest.mark.parametrize("name", ["facade", "night"])
def test_expected_values_are_means_over_errors(name):
    world = WORLDS[name](0)
    low, high = world.temperatures
    degC = np.linspace(low + 6, high - 6, 9)
    errors = np.random.default_rng(0).normal(0, 1.5, (20_000, 1))
    means = (thermal_image(degC + errors, world) / 255.0).mean(axis=0).reshape(9, -1)
    assert ExpectedValues(world, 1.5)(degC) == pytest.approx(means, abs=2e-3)


def test_ceiling_of_noise_is_its_variance(tmp_path):
    dataset = SyntheticDataset(
        str(tmp_path), ReadOptions(), width=80, height=60, views=8, errors=CaptureErrors(noise_degC=1.0)
    )
    scene = dataset.load("facade")
    span = scene.temperature.max - scene.temperature.min
    variance = 1 / span**2 + 1 / 255**2 / 12
    assert true_ceiling(dataset, scene) == pytest.approx(-10 * np.log10(variance), abs=0.15)


def test_displacements_lower_the_ceiling_by_what_they_change(tmp_path):
    """Four times the variance of displacements costs up to 6 dB."""
    found = []
    for degrees in (0.3, 0.6):
        errors = CaptureErrors(noise_degC=0.0, pose_degrees=degrees)
        dataset = SyntheticDataset(str(tmp_path), ReadOptions(), width=80, height=60, views=8, errors=errors)
        found.append(true_ceiling(dataset, dataset.load("facade")))
    assert 1.5 < found[0] - found[1] < 6.5


def test_above_the_highest_nothing_is_compared():
    assert Comparison(54.0, 45.0, 1.0).difference == 0
    assert Comparison(44.0, 45.0, 1.0).difference == 1
