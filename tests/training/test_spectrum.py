import numpy as np
import pytest

from tdgbench.training.spectrum import QUANTISATION, noise_of, significant_amplitudes, typical_noise


def scene(sigma: float) -> np.ndarray:
    """A ramp with a bright square, and noise."""
    y, x = np.mgrid[:96, :128] / 128
    image = 0.3 * x + 0.2 * y + 0.3 * ((x > 0.4) & (x < 0.6) & (y > 0.2) & (y < 0.5))
    return (image + np.random.default_rng(0).normal(0, sigma, image.shape))[..., None].astype(np.float32)


@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.1])
def test_noise_is_told_from_ramps_and_edges(sigma):
    assert noise_of(scene(sigma)) == pytest.approx(sigma, rel=0.05)


def test_noise_is_at_least_that_of_8_bits():
    assert noise_of(scene(0.0)) == noise_of(np.zeros((2, 2, 1), np.float32)) == QUANTISATION


def test_windows_with_a_masked_pixel_do_not_count():
    image, valid = scene(0.02), np.ones((96, 128), bool)
    valid[:, ::2] = False
    assert noise_of(image, valid) == QUANTISATION  # no whole window is left
    valid[:, :64] = True
    image[:, 64:] += np.random.default_rng(1).normal(0, 0.5, (96, 64, 1))
    assert noise_of(image, valid) == pytest.approx(0.02, rel=0.1)


def test_the_typical_noise_is_a_median():
    assert typical_noise([(scene(s), None) for s in (0.01, 0.02, 0.5)]) == pytest.approx(0.02, rel=0.05)


SCALES = (8, 4, 2, 1)


def test_smooth_images_are_whole_at_a_low_resolution_and_fine_ones_are_not():
    y, x = np.mgrid[:96, :128]
    coarse, fine = (np.sin(2 * np.pi * (x + y) / period)[..., None] for period in (40, 3))
    assert significant_amplitudes(coarse, 0.001, SCALES)[0] > 0.7
    assert significant_amplitudes(fine, 0.001, SCALES)[2] < 0.05


def test_noise_has_no_part():
    y, x = np.mgrid[:96, :128]
    coarse = np.sin(2 * np.pi * (x + y) / 40)[..., None]
    noisy = coarse + np.random.default_rng(0).normal(0, 0.2, coarse.shape)
    shares, unaware = (significant_amplitudes(noisy, noise, SCALES) for noise in (0.2, 0.0))
    assert shares[0] > 2 * unaware[0] and shares[0] > 0.4


def test_an_image_of_nothing_has_all_of_it_at_every_scale():
    assert significant_amplitudes(np.full((32, 32, 3), 0.5), 0.01, SCALES).tolist() == [1.0] * 4
