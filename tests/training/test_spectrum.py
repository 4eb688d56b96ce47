import numpy as np

from tdgbench.training.spectrum import significant_amplitudes

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
