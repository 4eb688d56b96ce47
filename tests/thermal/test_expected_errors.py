import numpy as np
import pytest

from tdgbench.thermal.expected_errors import ExpectedErrors, fit_drift, sequence_positions, shutter_events

PLACES = np.arange(60.0)
ALL = np.ones(60, bool)


def smooth(seed, length=10.0):
    """A drift (60,) of standard deviation 1 or so."""
    far = np.subtract.outer(PLACES, PLACES) / length
    return np.random.default_rng(seed).multivariate_normal(np.zeros(60), np.exp(-(far**2) / 2))


def test_places_are_in_the_order_of_counters_and_time_stamps():
    assert sequence_positions(["a_2", "b_1", "a_10"]) == {"a_2": 0, "a_10": 1, "b_1": 2}
    assert sequence_positions(["20240101_235959", "20240102_000001", "20240101_000000"])["20240101_235959"] == 1
    assert all(np.isnan(place) for place in sequence_positions(["view_1", "north"]).values())


def test_names_of_splits_do_not_count():
    """As in ThermoScenes; where each split has its own counter, the sequence is not known."""
    names = [f"frame_{'eval' if number % 5 == 0 else 'train'}_{number:05}" for number in range(20)]
    assert [*sequence_positions(names).values()] == [*range(20)]
    assert np.isnan([*sequence_positions(["frame_train_1", "frame_eval_1", "frame_train_2"]).values()]).all()
    assert [*sequence_positions(["trainyard_2", "trainyard_1"]).values()] == [1, 0]  # part of a word


def test_a_smooth_drift_lets_expect_views_between_others():
    for seed in range(3):
        offsets, known = smooth(seed), np.arange(60) % 5 != 2
        drift = fit_drift(PLACES, offsets, known, 2.0)
        assert drift.jitter <= 0.1 and drift.length >= 4
        error = drift.expected(PLACES[~known], PLACES[known], offsets[known]) - offsets[~known]
        assert np.std(error) < 0.1 and np.std(error) < 0.25 * np.std(offsets[~known])


def test_offsets_without_an_order_let_expect_nothing():
    for seed in range(3):
        offsets, known = np.random.default_rng(seed).normal(size=60), np.arange(60) % 5 != 2
        drift = fit_drift(PLACES, offsets, known, 2.0)
        assert drift.jitter >= 0.9
        assert np.abs(drift.expected(PLACES[~known], PLACES[known], offsets[known])).max() < 0.4


def test_nothing_is_expected_across_a_shutter_event():
    offsets = 0.05 * (PLACES % 20) + np.random.default_rng(0).normal(0, 0.01, 60)
    known = ALL.copy()
    known[20] = False  # the first after the shutter
    drift = fit_drift(PLACES, offsets - offsets.mean(), known, 2.0)
    assert drift.events == (20.0, 39.5)
    assert fit_drift(PLACES, offsets - offsets.mean(), ALL, 2.0).events == (19.5, 39.5)
    after = drift.expected(np.array([20.5]), PLACES[known], (offsets - offsets.mean())[known])
    assert after == pytest.approx(-offsets.mean(), abs=0.1) and -offsets.mean() < -0.4


def test_a_walk_has_no_shutter_events():
    assert shutter_events(PLACES, np.cumsum(np.random.default_rng(1).normal(size=60))) == ()


def test_no_drift_varies_more_than_cameras_do():
    assert fit_drift(PLACES, 100 * smooth(0), ALL, 2.0).variance == 4.0
    assert fit_drift(PLACES, smooth(0), ALL, 2.0).variance == pytest.approx(np.mean(smooth(0) ** 2))


def test_widths_of_images_without_temperatures_follow_their_contrast():
    assert ExpectedErrors.in_unit("°C", 5.0) == ExpectedErrors.in_unit("°C", 0.1)
    low, high = ExpectedErrors.in_unit("image", 0.1), ExpectedErrors.in_unit("image", 0.2)
    assert (high.offsets, high.gains, high.vignette) == pytest.approx((2 * low.offsets, low.gains, 2 * low.vignette))
