"""The colour scale of a view: robust, round, and what is printed is what is drawn."""

import numpy as np
import pytest

from tdgbench.present.colour_scale import NARROWEST, ColourScale, colour_scale
from tdgbench.present.colours import in_colour


def facade(sky: float) -> np.ndarray:
    """A facade of 1 to 7 °C under a sky of -22 °C that is this share of the picture; 8 bits span -22 to 7 °C."""
    degrees = np.linspace(1, 7, 1000)
    degrees[: round(1000 * sky)] = -22
    return np.round(255 * (degrees + 22) / 29).astype(np.uint8).reshape(25, 40, 1)


@pytest.mark.parametrize(("sky", "coldest"), [(0, 1), (0.02, -2), (0.2, -4), (0.4, -8)])
def test_a_cold_sky_does_not_take_the_scale(sky, coldest):
    scale = colour_scale(facade(sky), degrees=(-22, 7))
    low, high = map(float, scale.ends)
    assert coldest <= low <= 2 and 6.9 <= high <= 7
    assert scale.low == pytest.approx((low + 22) / 29) and scale.high == pytest.approx((high + 22) / 29)
    error = scale.error * 29
    assert scale.error_end == f"{error:.2g} °C" and error == pytest.approx(0.15 * (high - low), 0.05)
    assert scale.warmer < 0.011 and sky - 0.001 <= scale.colder < sky + 0.011
    colours = in_colour(facade(sky), scale.low, scale.high).reshape(-1, 3)[round(1000 * sky) :].astype(int)
    assert np.abs(colours[0] - colours[-1]).sum() > 200 and len(np.unique(colours, axis=0)) > 20  # no one orange


def test_hot_pixels_have_colours_of_their_own_and_masked_ones_do_not_count():
    room = np.full((20, 20, 1), 100, np.uint8)
    room[:3], room[:, 0] = 250, 0
    valid = np.ones((20, 20), bool)
    valid[:, 0] = False
    scale = colour_scale(room, valid)
    assert scale.high * 255 >= 250 and scale.colder == scale.warmer == 0 and scale.ends == ("0.39", "0.99")


def test_a_level_of_noise_is_no_contrast():
    scale = colour_scale(np.uint8([[[127], [128]]] * 50))
    assert NARROWEST <= scale.high - scale.low < 1.5 * NARROWEST
    assert np.ptp(in_colour(np.uint8([[[127], [128]]]), scale.low, scale.high).astype(int), axis=1).max() < 30


@pytest.mark.parametrize("level", [0, 1, 254, 255])
def test_the_narrowest_scale_is_as_wide_at_the_ends_of_the_range(level):
    scale = colour_scale(np.full((5, 5, 1), level, np.uint8))
    assert NARROWEST <= scale.high - scale.low + 1e-9 < 1.5 * NARROWEST
    assert 0 <= scale.low <= level / 255 <= scale.high <= 1


def test_other_ranges_have_the_same_degrees_at_the_ends():
    scale = colour_scale(facade(0.0), degrees=(-22, 7))
    other = scale.of_range((-30, 20))
    assert np.allclose(
        [29 * end - 22 for end in (scale.low, scale.high)], [50 * e - 30 for e in (other.low, other.high)]
    )
    assert other.error * 50 == pytest.approx(scale.error * 29) and other.sentence == scale.sentence
    assert scale.of_range((-22, 7)) is scale
    with pytest.raises(ValueError, match="unknown"):
        scale.of_range(None)


def test_a_palette_has_no_scale():
    assert colour_scale(np.zeros((3, 4, 3), np.uint8), degrees=(0, 9)) == ColourScale()
