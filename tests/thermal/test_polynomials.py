import numpy as np
import pytest

from tdgbench.scenes.synthetic.capture import vignette
from tdgbench.thermal.maps import TERMS, evaluate, legendre_basis


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


def test_the_map_is_the_sum_of_the_polynomials():
    coefficients = np.random.default_rng(0).normal(size=len(TERMS))
    x, y = np.meshgrid((np.arange(31) + 0.5) / 31, (np.arange(20) + 0.5) / 20)
    values = (legendre_basis(x.ravel(), y.ravel()) @ coefficients).reshape(20, 31)
    assert evaluate(coefficients, 31, 20) == pytest.approx(values - values.mean(), abs=1e-12)
