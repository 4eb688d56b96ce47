import numpy as np
import pytest

from tdgbench.ceiling.noise import noise_variance


@pytest.mark.parametrize("sigma", [0.005, 0.05])
def test_noise_beside_edges_and_masked_garbage(sigma):
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(160), np.arange(120))
    image = 0.5 + 0.2 * np.sin(x / 20) * np.cos(y / 15) + 0.2 * (x + y > 150) + rng.normal(0, sigma, x.shape)
    valid = np.ones(image.shape, bool)
    image[:30, :40], valid[:30, :40] = rng.uniform(0, 1, (30, 40)), False
    assert noise_variance(image, valid) ** 0.5 == pytest.approx(sigma, rel=0.1)
