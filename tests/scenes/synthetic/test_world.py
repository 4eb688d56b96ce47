import numpy as np
import pytest

from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.scenes.synthetic.worlds import WORLDS

SIZE = {"width": 48, "height": 36, "views": 10, "points": 300}


def load(root, name, **errors):
    capture = CaptureErrors(thermal_camera=ThermalErrors(encoding="degC"), **errors)
    return SyntheticDataset(str(root), ReadOptions(), **SIZE, errors=capture).load(name)


@pytest.mark.parametrize("name", ["field", "wall"])
def test_a_gradient_is_linear_from_end_to_end(tmp_path, name):
    flat, warmer = load(tmp_path, name), load(tmp_path, name, gradient_degC=6.0)
    low, high = flat.temperature.min, flat.temperature.max
    assert (warmer.temperature.min, warmer.temperature.max) == (low - 3, high + 3)
    added, x = [], []
    for before, after in zip(flat.views, warmer.views, strict=True):
        camera, degC = before.camera, after.true_temperature - before.true_temperature
        places = (np.arange(48) + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * before.true_depth
        assert np.abs(camera.world_to_camera[0, :3] - [1, 0, 0]).max() < 0.01  # images have the world's x to the right
        x.append(camera.center[0] + places)
        added.append(degC)
    slope, at_zero = np.polyfit(np.ravel(x), np.ravel(added), 1)
    length = WORLDS[name](0).length
    assert slope * length == pytest.approx(6, rel=0.01) and at_zero == pytest.approx(0, abs=0.05)
    assert np.ptp(x) == pytest.approx(length, rel=0.05)


def test_worlds_without_a_long_axis_have_no_gradient(tmp_path):
    plain, asked = load(tmp_path, "turntable"), load(tmp_path, "turntable", gradient_degC=6.0)
    assert asked.fingerprint == plain.fingerprint and asked.folder != plain.folder
