import numpy as np
import pytest

from tdgbench.ceiling.displacement import displaced, spread_by_displacement


@pytest.mark.parametrize("variance", [0.1, 1.0, 4.0])
def test_waves_as_by_random_displacements(variance):
    """Of sin(kx), displaced by normal numbers, the variance over all pixels is (1 − exp(−k²σ²)) / 2."""
    k = 2 * np.pi / 16
    image = np.sin(k * np.arange(256))[None].repeat(8, axis=0)
    found = spread_by_displacement(image, None, variance)[:, 32:-32].mean()
    assert found == pytest.approx((1 - np.exp(-(k**2) * variance)) / 2, rel=0.03)


def test_masked_pixels_count_for_nothing():
    image, valid = np.full((9, 9), 0.5), np.ones((9, 9), bool)
    image[4, 4], valid[4, 4] = 9.0, False
    assert np.allclose(displaced(image, valid, 1.0), 0.5)
    assert spread_by_displacement(image, valid, 1.0)[valid].max() < 1e-9
    assert spread_by_displacement(image, None, 1.0).max() > 0.1
