import numpy as np
import pytest

from tdgbench.ceiling.images import SmallImage
from tdgbench.ceiling.sightings import Sightings
from tdgbench.ceiling.spread import find_drift, flat_error
from tdgbench.scenes import Camera

VIEWS, POINTS = 12, 600


@pytest.fixture
def sightings():
    """Every view sees two thirds of the points, at random."""
    rng = np.random.default_rng(0)
    view, point = np.nonzero(rng.random((VIEWS, POINTS)) < 2 / 3)
    cameras = tuple(Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), 64, 48) for _ in range(VIEWS))
    return Sightings(point, view, rng.uniform(0, 1, (POINTS, 3)) + np.array([0, 0, 2]), cameras)


def test_drift_of_known_tones(sightings):
    """Dark and bright parts drift differently; a tenth of the values is wrong."""
    rng = np.random.default_rng(1)
    own = rng.uniform(0.2, 0.8, POINTS)
    offset, gain = rng.normal(0, 0.03, (2, VIEWS))
    offset, gain = offset - offset.mean(), gain - gain.mean()
    true = (offset[:, None] + gain[:, None] * (own - 0.5))[sightings.view, sightings.point]
    values = own[sightings.point] + true + rng.normal(0, 0.005, len(true)) + 0.3 * (rng.random(len(true)) < 0.02)
    images = [SmallImage(rng.uniform(0.2, 0.8, (48, 64)), None)] * VIEWS
    found = find_drift(images, sightings, values[:, None], np.ones(len(true)))
    assert np.sqrt(np.mean((found.at_sightings[:, 0] - true) ** 2)) < 0.15 * true.std()
    assert found.errors.mean() == pytest.approx(np.mean(offset**2 + gain**2 * 0.03), rel=0.1)


def test_error_in_flat_areas_beside_steep_ones(sightings):
    rng = np.random.default_rng(2)
    own, steepness = rng.uniform(0.2, 0.8, POINTS), rng.uniform(0, 0.1, POINTS)[sightings.point]
    values = own[sightings.point] + rng.normal(0, np.sqrt(0.01**2 + (0.3 * steepness) ** 2))
    assert flat_error(sightings, values[:, None], steepness) ** 0.5 == pytest.approx(0.01, rel=0.12)
