import numpy as np
import pytest

from tdgbench.scenes.synthetic.capture import vignette
from tdgbench.thermal.camera import ViewResponses, normalized
from tdgbench.thermal.maps import TERMS, evaluate, legendre_basis


def test_normalization_changes_no_value():
    """Temperatures T' = T scaled and shifted with the normalization give the same values at the reference r."""
    before, r = ViewResponses(np.array([1.0, -2.0, 4.0]), np.array([1.1, 0.9, 1.3])), 20.0
    after, degC = normalized(before), np.linspace(10, 30, 5)[:, None]
    moved = r + before.gains.mean() * (degC - r) + before.offsets.mean()
    assert r + after.gains * (moved - r) + after.offsets == pytest.approx(
        r + before.gains * (degC - r) + before.offsets
    )
    assert after.offsets.mean() == pytest.approx(0) and after.gains.mean() == pytest.approx(1)


def test_polynomials_are_orthonormal_and_have_no_mean():
    x, y = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(300) + 0.5) / 300)
    values = legendre_basis(x.ravel(), y.ravel())
    assert values.T @ values / len(values) == pytest.approx(np.eye(len(TERMS)), abs=1e-3)
    assert values.mean(axis=0) == pytest.approx(np.zeros(len(TERMS)), abs=1e-4)
    assert evaluate(np.ones(len(TERMS)), 40, 30).mean() == pytest.approx(0, abs=1e-12)


def test_a_radial_vignette_is_among_them():
    shape = vignette(64, 48)
    x, y = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(48) + 0.5) / 48)
    values = legendre_basis(x.ravel(), y.ravel())
    coefficients = np.linalg.lstsq(values, (shape - shape.mean()).ravel(), rcond=None)[0]
    assert evaluate(coefficients, 64, 48) == pytest.approx(shape - shape.mean(), abs=1e-3)
