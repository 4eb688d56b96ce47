import numpy as np
import pytest

from tdgbench.thermal.explain import choose_terms, explain
from tdgbench.thermal.fit import Terms
from tests.helpers.sightings import sightings

STILL, EVEN = np.zeros(12), np.ones(12)
DRIFT, GAINS = np.linspace(-4, 4, 12), np.tile([0.9, 1.0, 1.1], 4)
BOWL = np.array([0.0, 0.0, 0.5, 0.0, 0.5, *[0.0] * 9])


@pytest.mark.parametrize(
    ("camera", "terms"),
    [
        ({"offsets": STILL, "gains": EVEN}, Terms()),
        ({"offsets": STILL, "gains": EVEN, "coefficients": BOWL}, Terms(vignette=True)),
        ({"offsets": DRIFT, "gains": EVEN}, Terms(vignette=True, offsets=True)),
        ({"offsets": DRIFT, "gains": GAINS}, Terms(vignette=True, offsets=True, gains=True)),
    ],
    ids=["ideal", "vignette", "offsets", "gains"],
)
def test_terms_are_those_of_the_camera(camera, terms):
    data, _ = sightings(**camera)
    assert choose_terms(data, 0.05) == terms


def test_a_pattern_of_columns_is_found_and_noise_is_none():
    columns = np.random.default_rng(3).normal(0, 0.3, 64)
    data, _ = sightings(STILL, EVEN, columns=columns, points=2000)
    blurless = data.kept(np.ones(len(data.value), bool))
    found, terms = explain(blurless, 0.05)
    assert terms.pattern and np.corrcoef(found.columns, columns)[0, 1] > 0.95
    plain, terms = explain(sightings(STILL, EVEN, points=2000)[0], 0.05)
    assert not terms.pattern and plain.columns is None and plain.rows is None
