import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tdgbench.bench.options import OptionError, check_options
from tdgbench.scenes.synthetic.capture import ThermalErrors, vignette
from tests.helpers.configs import config

SIZE, SPAN = (48, 36), (10.0, 30.0)


def drawn(views=40, drifts=None, **errors):
    return ThermalErrors(**errors).drawn(SIZE, SPAN, np.zeros(views) if drifts is None else drifts, [0])


def scene_temperatures():
    return gaussian_filter(np.random.default_rng(1).uniform(12, 28, (36, 48)), 2)


def test_the_walk_is_smooth_and_reaches_its_largest_value():
    offsets = drawn(walk_degC=4.0).offsets
    assert np.abs(offsets).max() == pytest.approx(4.0) and offsets.mean() == pytest.approx(0)
    assert np.abs(np.diff(offsets)).max() < 1.5


def test_response_follows_the_model():
    camera = drawn(drifts=np.linspace(-2, 2, 40), gain=0.05, vignette_degC=2.6, pattern_degC=0.3)
    degC = scene_temperatures()
    for view in (0, 17):
        expected = 20 + camera.gains[view] * (degC - 20) + camera.offsets[view] + camera.vignette + camera.pattern
        assert np.allclose(camera.shown(degC, view, np.zeros_like(degC)), expected)
    assert camera.gains.min() < 0.97 and camera.gains.max() > 1.03 and np.abs(camera.gains - 1).max() <= 0.05
    assert camera.offsets.tolist() == np.linspace(-2, 2, 40).tolist()


def test_vignette_is_radial_and_as_asked_at_the_corners():
    shape, shifted = vignette(64, 48), vignette(64, 48, 0.25, -0.5)
    assert np.allclose(shape, shape[::-1]) and np.allclose(shape, shape[:, ::-1])
    assert shape.max() == pytest.approx(1, abs=0.07) and shape.min() == pytest.approx(0, abs=1e-3)
    row, column = np.unravel_index(shifted.argmin(), shape.shape)
    assert row == 0 and column in (47, 48) and shifted.max() == shifted[-1, 0] == pytest.approx(1, abs=0.05)


def test_pattern_is_partly_one_of_columns():
    pattern = drawn(pattern_degC=0.5).pattern
    assert pattern.std() == pytest.approx(0.5, rel=0.15) and pattern.mean() == pytest.approx(0, abs=1e-9)
    assert pattern.mean(axis=0).std() > 3 * pattern.mean(axis=1).std()


def test_one_error_does_not_change_the_random_numbers_of_another():
    both, one = drawn(walk_degC=1.0, gain=0.05, pattern_degC=0.1), drawn(gain=0.05)
    assert np.array_equal(both.gains, one.gains)
    assert np.array_equal(both.pattern, drawn(pattern_degC=0.1).pattern)


@pytest.mark.parametrize("wrong", ["gain=2", "encoding=jpeg", "shutter_views=-1", "walk_degC=nan"])
def test_options_are_checked_where_they_enter(wrong):
    option = f"dataset.loader.errors.thermal_camera.{wrong}"
    check_options(config("dataset=synthetic", "dataset.loader.errors.thermal_camera.encoding=agc"))
    with pytest.raises(OptionError, match=option.partition("=")[0]):
        check_options(config("dataset=synthetic", option))
