import numpy as np
import pytest

from tdgbench.thermal.camera import ViewResponses, normalized
from tdgbench.thermal.fit import Terms, fit
from tests.helpers.observations import loose, observations

OFFSETS, GAINS = np.linspace(-4, 4, 12), np.tile([0.95, 1.0, 1.05], 4)
ALL = Terms(vignette=True, offsets=True, gains=True)


def true_response(reference):
    return normalized(ViewResponses(OFFSETS + (GAINS - 1) * (reference - 20), GAINS))


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_response_is_recovered(outliers):
    coefficients = np.array([0.3, -0.2, 0.4, 0.1, 0.5, *[0.0] * 9])
    data, _ = observations(OFFSETS, GAINS, coefficients=coefficients, outliers=outliers)
    found = fit(data, ALL, loose(data))
    response, true = normalized(found.response), true_response(found.reference)
    assert np.abs(response.offsets - true.offsets).max() < 0.03
    assert np.abs(response.gains - true.gains).max() < 0.003
    assert np.abs(found.vignette - coefficients).max() < 0.02
    assert found.after == pytest.approx(0.05, rel=0.2) and found.before > 1


def test_noise_does_not_bias_gains():
    """Regression on means of the values would draw gains towards 0."""
    data, _ = observations(np.zeros(4), np.array([0.9, 1.1, 0.9, 1.1]), noise=1.5, points=6000)
    gains = normalized(fit(data, ALL, loose(data)).response).gains
    assert gains == pytest.approx([0.9, 1.1, 0.9, 1.1], abs=0.015)


def test_terms_that_are_not_estimated_are_ideal():
    data, _ = observations(OFFSETS, GAINS)
    found = fit(data, Terms(offsets=True), loose(data))
    assert (found.response.gains == 1).all() and (found.vignette == 0).all() and np.ptp(found.response.offsets) > 7
    found = fit(data, Terms(), loose(data))
    assert (found.response.offsets == 0).all()


def test_what_few_values_tell_little_about_is_drawn_to_the_prior():
    data, _ = observations(OFFSETS, np.ones(12), noise=3.0)
    few = data.select((data.view != 11) | (np.arange(len(data.value)) % 40 == 0))
    whole, drawn = (fit(one, Terms(offsets=True), loose(one)).response.offsets[11] for one in (data, few))
    assert whole == pytest.approx(4, abs=0.6) and drawn < whole - 0.3
