import numpy as np

from tdgbench.ceiling.sightings import Sightings
from tdgbench.scenes import Camera

CAMERAS = tuple(Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), 64, 48) for _ in range(3))
POINT, VIEW = np.array([0, 1, 0, 1, 0]), np.array([0, 0, 1, 1, 2])  # point 1 is not seen by view 2


def made() -> Sightings:
    return Sightings(POINT, VIEW, np.array([[0.0, 0, 2], [0.5, 0, 2]]), CAMERAS)


def test_mean_of_a_points_other_views():
    values = np.array([1.0, 10.0, 2.0, 20.0, 6.0])
    assert made().mean_of_others(values).tolist() == [4.0, 20.0, 3.5, 10.0, 1.5]


def test_unknown_values_count_for_nothing():
    values = np.array([1.0, 10.0, np.nan, 20.0, 6.0])
    assert made().mean_of_others(values).tolist() == [6.0, 20.0, 3.5, 10.0, 1.0]


def test_median_of_a_point():
    assert made().median(np.array([1.0, 10.0, 2.0, 20.0, 6.0])).tolist() == [2.0, 10.0, 2.0, 10.0, 2.0]


def test_contrast_is_the_mean_difference_from_other_views():
    sightings, drift = made(), np.array([0.3, -0.2, 0.5])
    values = drift[sightings.view]
    rest = values - sightings.mean_of_others(values)
    expected = [rest[sightings.view == view].mean() for view in range(3)]
    assert np.allclose(sightings.contrast() @ drift, expected)


def test_halves_share_no_point():
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (400, 3)) + np.array([0, 0, 3])
    one, other = Sightings(np.arange(400), np.zeros(400, int), points, CAMERAS).halves()
    assert not (one & other).any()
    assert min(one.sum(), other.sum()) > 50
