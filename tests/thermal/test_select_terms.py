from dataclasses import replace

import numpy as np
import pytest

from tdgbench.thermal.fit import Terms
from tdgbench.thermal.maps import TERMS
from tdgbench.thermal.select_terms import choose_terms, fit_selected_terms, held_out_errors
from tests.helpers.observations import DEGC, NOWHERE, along_a_line, observations

STILL, EVEN, ORDER = np.zeros(12), np.ones(12), np.arange(12.0)
DRIFT, GAINS = np.linspace(-4, 4, 12), np.tile([0.9, 1.0, 1.1], 4)
BOWL = np.array([0.5 if term in ((2, 0), (0, 2)) else 0.0 for term in TERMS])


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize(
    ("camera", "terms"),
    [
        ({"offsets": STILL, "gains": EVEN}, Terms()),
        ({"offsets": STILL, "gains": EVEN, "coefficients": BOWL}, Terms(vignette=True)),
        ({"offsets": DRIFT, "gains": EVEN}, Terms(offsets=True)),
        ({"offsets": DRIFT, "gains": EVEN, "coefficients": BOWL}, Terms(vignette=True, offsets=True)),
        ({"offsets": DRIFT, "gains": GAINS}, Terms(offsets=True, gains=True)),
    ],
    ids=["ideal", "vignette", "offsets", "both", "gains"],
)
def test_terms_are_those_of_the_camera(camera, terms):
    assert choose_terms(observations(**camera)[0], DEGC, ORDER) == terms


@pytest.mark.parametrize(("travel", "jitter"), [(0.2, 0.0), (0.2, 0.3), (1.0, 0.0)])
def test_a_drift_along_a_line_is_no_vignette(travel, jitter):
    """Image widths; °C. A tilted vignette of 4 to 20 °C would show the points alike, and is less likely."""
    data = along_a_line(travel, 0.0, noise=0.1)
    offsets = np.linspace(-2, 2, 12) + np.random.default_rng(0).normal(0, jitter, 12)
    assert choose_terms(replace(data, value=data.value + offsets[data.view]), DEGC, ORDER) == Terms(offsets=True)


def test_offsets_without_an_order_are_accepted_for_truer_temperatures():
    """The view's own offset cannot be expected then, but the other half of its image tells it."""
    offsets = np.random.default_rng(2).normal(0, 2, 12)
    assert choose_terms(observations(offsets, EVEN)[0], DEGC, NOWHERE) == Terms(offsets=True)


def test_gains_need_clear_evidence():
    """1 % of gain changes values by the noise, but predicts held-out views by less than a tenth better."""
    for share, accepted in ((0.004, False), (0.1, True)):
        gains = 1 + share * np.tile([-1, 0, 1], 4)
        assert choose_terms(observations(DRIFT, gains)[0], DEGC, ORDER).gains is accepted


def test_the_neighbours_in_the_sequence_predict_a_view_that_is_not_read():
    data, _ = observations(DRIFT, EVEN)
    offsets = Terms(offsets=True)
    (unread, halves), (alone, same) = (held_out_errors(data, offsets, DEGC, at) for at in (ORDER, NOWHERE))
    ideal, _ = held_out_errors(data, Terms(), DEGC, ORDER)
    assert rms(unread) < 0.3 * rms(alone) and rms(unread) < 0.3 * rms(ideal)
    assert rms(halves) == pytest.approx(rms(same), rel=0.05) and rms(halves) < 0.1


def test_no_value_of_a_held_out_view_is_read():
    """The errors of the first view, which is in the first group, change by what its values change by."""
    data, terms = observations(DRIFT, EVEN)[0], Terms(vignette=True, offsets=True)
    moved = replace(data, value=data.value + 100.0 * (data.view == 0))
    before, after = (held_out_errors(one, terms, DEGC, ORDER)[0] for one in (data, moved))
    first = np.count_nonzero(data.view == 0) // 2  # a few points are seen by too few other views
    assert after[:first] - before[:first] == pytest.approx(100)


def test_what_parts_of_a_scene_contradict_each_other_about_does_not_wander():
    """Without holding back, the largest coefficient of the vignette is 1.8 to 3.1 °C; without an order, no drift is."""
    found, _, drift = fit_selected_terms(along_a_line(0.01, 0.2, seed=0), DEGC, NOWHERE)
    assert np.abs(found.vignette).max() < 1.5 and drift is None


def test_a_drift_is_found_in_the_order_of_the_views():
    data, _ = observations(DRIFT, EVEN)
    found, terms, drift = fit_selected_terms(data, DEGC, ORDER)
    assert terms.offsets and drift.jitter < 0.1 and drift.variance <= DEGC.offsets**2
    assert np.abs(found.response.offsets - found.response.offsets.mean() - DRIFT).max() < 0.05
