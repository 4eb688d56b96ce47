import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from tdgbench.splats.cpu.losses.ssim import SIGMA, WINDOW, window


def test_the_window_is_a_truncated_gaussian():
    weights = window()
    assert weights.sum() == pytest.approx(1) and np.array_equal(weights, weights[::-1])
    impulse = np.zeros(41)
    impulse[20] = 1
    filtered = gaussian_filter1d(impulse, SIGMA, truncate=(WINDOW // 2) / SIGMA)
    assert np.allclose(filtered[15:26], weights)
