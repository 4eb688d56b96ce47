import numpy as np
import pytest

from tdgbench.thermal.fit import Terms, fit
from tdgbench.thermal.maps import TERMS as POLYNOMIALS
from tdgbench.thermal.maps import evaluate
from tdgbench.thermal.select_terms import shrink_towards_ideal
from tests.helpers.observations import along_a_line, loose, observations

TERMS = Terms(vignette=True, offsets=True)
BOWL = np.array([0.5 if term in ((2, 0), (0, 2)) else 0.0 for term in POLYNOMIALS])


def both(data, terms=TERMS):
    """The fit as it is, and held back."""
    found = fit(data, terms, loose(data))
    return found, shrink_towards_ideal(data, found, terms, loose(data))


def size(found, true=0.0):
    """Root mean square of the vignette's error over the image, °C."""
    return float(np.sqrt(np.mean(evaluate(found.vignette - true, 64, 48) ** 2)))


@pytest.mark.parametrize("seed", range(2))
def test_what_parts_of_the_scene_contradict_each_other_about_is_held_back(seed):
    """0.2 °C, which the model lacks, become degrees of vignette where the camera hardly moves."""
    found, held = both(along_a_line(0.01, 0.2, seed=seed))
    assert size(found) > 2 and size(held) < 0.4 * size(found) and size(held) < 2
    assert held.undetermined > found.undetermined


def test_without_contradictions_nothing_more_is_held_back():
    """The same path without the error."""
    data = along_a_line(0.01, 0.0, coefficients=BOWL)
    found, held = both(data)
    assert size(held, BOWL) == pytest.approx(size(found, BOWL), abs=0.02) and held.undetermined == found.undetermined


def test_what_all_parts_of_the_scene_agree_about_stays():
    data, _ = observations(np.linspace(-2, 2, 12), np.tile([0.95, 1.0, 1.05], 4), coefficients=BOWL)
    found, held = both(data, Terms(vignette=True, offsets=True, gains=True))
    assert np.abs(held.response.offsets - found.response.offsets).max() < 1e-3
    assert np.abs(held.response.gains - found.response.gains).max() < 1e-3
    assert np.abs(held.vignette - found.vignette).max() < 1e-3
    assert held.residuals == pytest.approx(found.residuals, abs=0.01)


def test_undetermined_directions_are_counted():
    """Mean offset and mean gain; along a line also what is linear in x, and the four terms of y alone."""
    data, _ = observations(np.zeros(12), np.ones(12))
    counted = [both(data, Terms(offsets=True, gains=gains))[1].undetermined for gains in (False, True)]
    assert counted == [1, 2] and both(data, Terms(vignette=True))[1].undetermined == 0
    assert both(along_a_line(1.0, 0.0))[1].undetermined == 6


def test_a_direction_that_no_value_tells_about_stays_ideal():
    found, held = both(along_a_line(1.0, 0.0, coefficients=BOWL))
    in_x, in_y = POLYNOMIALS.index((2, 0)), POLYNOMIALS.index((0, 2))  # along y the camera does not move
    for one in (found, held):
        assert one.vignette[in_x] == pytest.approx(0.5, abs=0.02) and one.vignette[in_y] == pytest.approx(0, abs=0.02)
