"""PSNR against scikit-image."""

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from tdgbench.scoring.metrics.psnr import MAX_PSNR, psnr
from tests.scoring.images import images


@pytest.mark.parametrize("size", [(40, 50, 3), (33, 27, 1), (1, 1, 1)])
def test_is_scikit_image_s(size):
    a, b = images(size)
    expected = peak_signal_noise_ratio(b.astype(np.float64), a.astype(np.float64), data_range=1)
    assert psnr(a, b) == pytest.approx(expected, abs=1e-6)


def test_equal_images_have_a_finite_psnr():
    a, _ = images((5, 5, 1))
    assert psnr(a, a) == MAX_PSNR


def test_wrong_sizes():
    with pytest.raises(ValueError, match="images to compare"):
        psnr(np.zeros((3, 3, 1)), np.zeros((3, 4, 1)))
