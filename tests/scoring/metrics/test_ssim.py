"""SSIM against scikit-image."""

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from tdgbench.scoring.metrics.ssim import ssim
from tdgbench.scoring.scored_view import NotApplicableError
from tests.scoring.images import images

SIZES = [(40, 50, 3), (33, 27, 1), (11, 60, 3)]
SETTINGS = {
    "gaussian_weights": True,
    "sigma": 1.5,
    "use_sample_covariance": False,
    "data_range": 1.0,
    "channel_axis": 2,
}


@pytest.mark.parametrize("size", SIZES)
def test_standard_ssim_is_scikit_image_s(size):
    a, b = (image.astype(np.float64) for image in images(size))
    assert ssim(a, b, "valid") == pytest.approx(structural_similarity(a, b, **SETTINGS), abs=1e-6)


@pytest.mark.parametrize("size", SIZES)
def test_3dgs_ssim_is_scikit_image_s_on_padded_images(size):
    """Zeros outside the image: the same as scikit-image's map of the zero-padded images, cut back to the image."""
    a, b = (image.astype(np.float64) for image in images(size))
    pad = ((20, 20), (20, 20), (0, 0))
    _, full = structural_similarity(np.pad(a, pad), np.pad(b, pad), full=True, **SETTINGS)
    assert ssim(a, b, "zero") == pytest.approx(full[20:-20, 20:-20].mean(), abs=1e-6)


def test_an_image_smaller_than_the_window_has_none_inside():
    a, _ = images((10, 60, 1))
    with pytest.raises(NotApplicableError, match="needs 11×11 px; an image is 60×10"):
        ssim(a, a, "valid")


def test_ssim_of_equal_and_constant_images():
    a, _ = images((20, 20, 1))
    assert ssim(a, a, "zero") == pytest.approx(1)
    assert ssim(np.zeros((20, 20, 1)), np.ones((20, 20, 1)), "valid") == pytest.approx(1e-4 / 1.0001)
