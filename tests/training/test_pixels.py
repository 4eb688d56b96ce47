import dataclasses

import numpy as np
import pytest

from tdgbench.training.images import RGB, THERMAL
from tdgbench.training.pixels import PixelRule, significant_amplitudes
from tests.helpers.waves import view, wave

RULE = PixelRule(largest_scale=8, until=0.5, smallest_side=10)
SCALES = (8, 4, 2, 1)


def schedule(rule, one, modality=THERMAL, gaussians=100):
    """Return the resolutions of 1 000 iterations on a view."""
    return rule.resolutions([one], modality, gaussians, 1000)


def test_fine_images_get_their_pixels_early_and_coarse_ones_late():
    coarse, fine = (schedule(RULE, view(wave(period))) for period in (40, 3))
    assert [scale for _, scale in coarse] == [8, 6, 4, 3, 2] and coarse[0][0] > 300
    assert [last for last, _ in coarse] == sorted(last for last, _ in coarse) and coarse[-1][0] <= 500
    assert all(last < 60 for last, _ in fine)


def test_images_do_not_get_smaller_than_the_rule_says():
    rule = dataclasses.replace(RULE, smallest_side=40)
    assert [scale for _, scale in schedule(rule, view(wave(40)))] == [2]
    assert schedule(dataclasses.replace(RULE, largest_scale=1), view(wave(40))) == []


def test_images_have_no_fewer_pixels_than_there_are_gaussians():
    pixels = 128 * 96
    assert [scale for _, scale in schedule(RULE, view(wave(40)), gaussians=pixels // 9)] == [3, 2]
    assert schedule(RULE, view(wave(40)), gaussians=pixels) == []


def test_each_modality_has_a_schedule_of_its_own():
    both = view(wave(40), rgb=np.repeat(wave(3), 3, axis=2))
    thermal, rgb = (schedule(RULE, both, modality) for modality in (THERMAL, RGB))
    assert thermal[-1][0] > 300 and all(last < 60 for last, _ in rgb)


def test_the_border_of_a_mask_is_no_detail():
    ramp = np.tile(np.linspace(0.2, 0.8, 128, dtype=np.float32)[None, :, None], (96, 1, 1))
    valid = np.ones((96, 128), bool)
    valid[:, 100:] = False
    given = view(ramp), view(ramp * valid[..., None], valid)
    whole, masked = (schedule(RULE, one) for one in given)
    assert [scale for _, scale in masked] == [scale for _, scale in whole]
    assert [last for last, _ in masked] == pytest.approx([last for last, _ in whole], abs=10)


def test_noise_has_no_part():
    y, x = np.mgrid[:96, :128]
    coarse = np.sin(2 * np.pi * (x + y) / 40)[..., None]
    noisy = coarse + np.random.default_rng(0).normal(0, 0.2, coarse.shape)
    shares, unaware = (significant_amplitudes(noisy, noise, SCALES) for noise in (0.2, 0.0))
    assert shares[0] > 2 * unaware[0] and shares[0] > 0.4


def test_an_image_of_nothing_has_all_of_it_at_every_scale():
    assert significant_amplitudes(np.full((32, 32, 3), 0.5), 0.01, SCALES).tolist() == [1.0] * 4
