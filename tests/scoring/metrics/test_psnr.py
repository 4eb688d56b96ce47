"""PSNR against scikit-image; after a view's gain and offset, against numpy's least squares."""

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from tdgbench.scoring.metrics.psnr import MAX_PSNR, best_gain_and_offset, psnr, psnr_affine, psnr_right_half
from tdgbench.scoring.scored_view import NotApplicableError
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


@pytest.mark.parametrize("size", [(40, 50, 3), (33, 27, 1), (7, 2)])
def test_the_response_is_that_of_least_squares(size):
    image, target = images(size)
    x = image.astype(np.float64).ravel()
    (gain, offset), *_ = np.linalg.lstsq(np.stack([x, np.ones_like(x)], axis=1), target.ravel(), rcond=None)
    found = best_gain_and_offset(image, target)
    assert found.gain == pytest.approx(gain, rel=1e-6) and found.offset == pytest.approx(offset, abs=1e-6)


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.1), (0.8, 0.05), (1.2, -0.1)])
def test_what_a_camera_adds_is_left_out(gain, offset):
    target = 0.3 + 0.4 * np.random.default_rng(0).random((30, 40, 1))
    drifted = (target - offset) / gain
    assert psnr(drifted, target) < 35
    assert psnr_affine(drifted, target) > 99 and psnr_right_half(drifted, target) > 99


def test_what_cannot_be_fitted_is_not_turned_around():
    target = np.linspace(0, 1, 20)[:, None]
    assert best_gain_and_offset(1 - target, target) == (0.0, 0.5)
    assert best_gain_and_offset(np.full((20, 1), 0.2), target) == pytest.approx((1.0, 0.3))


def test_the_left_half_alone_decides():
    image, target = images((20, 31, 1))
    changed = target.copy()
    changed[:, :15] = 0.5 * changed[:, :15] + 0.2
    response = best_gain_and_offset(image[:, :15], changed[:, :15])
    assert psnr_right_half(image, changed) == pytest.approx(
        psnr(response.applied_to(image[:, 15:]), target[:, 15:]), abs=1e-6
    )
    assert psnr_right_half(image, changed) < psnr_right_half(image, target)


def test_masked_pixels_count_nothing():
    image, target = images((20, 30, 1))
    valid = np.random.default_rng(1).random((20, 30)) < 0.5
    spoilt = np.where(valid[..., None], image, np.float32(np.nan))
    left, right = valid[:, :15], valid[:, 15:]
    response = best_gain_and_offset(image[:, :15][left], target[:, :15][left])
    expected = psnr(response.applied_to(image[:, 15:][right]), target[:, 15:][right])
    assert psnr_right_half(spoilt, target, valid) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("columns", [slice(0, 15), slice(15, None)])
def test_a_half_without_a_pixel_has_no_score(columns):
    image, target = images((20, 30, 1))
    valid = np.ones((20, 30), bool)
    valid[:, columns] = False
    with pytest.raises(NotApplicableError, match="half"):
        psnr_right_half(image, target, valid)
