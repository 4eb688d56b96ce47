"""What models are trained on, and its mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tdgbench.scenes import Camera, View
from tdgbench.training.images import QUANTISATION, RGB, THERMAL, ViewTensors, noise_of

CPU = torch.device("cpu")


def masked(view, image: float = 9.0):
    """A view whose pixels outside a rectangle are masked, and hold `image`."""
    valid = np.zeros(view.thermal.shape[:2], bool)
    valid[3:9, 5:20] = True
    spoilt = np.where(valid[..., None], view.thermal, np.float32(image))
    return replace(view, load_thermal=lambda: spoilt, load_valid=lambda: valid)


def test_mean_by_channel(small_scene):
    views = small_scene.train
    for modality, images in ((THERMAL, [view.thermal for view in views]), (RGB, [view.rgb for view in views])):
        assert modality.mean(views) == pytest.approx(np.mean(images, axis=(0, 1, 2), dtype=np.float64), abs=1e-6)


def test_masked_pixels_have_no_part_in_the_mean(small_gray_scene):
    view = masked(small_gray_scene.train[0])
    assert THERMAL.mean([view]) == pytest.approx(view.thermal[view.valid].mean(axis=0), abs=1e-6)
    nothing = replace(view, load_valid=lambda: np.zeros_like(view.valid))
    assert THERMAL.mean([nothing]) == [0]


def test_tensors_of_a_view_share_its_memory_and_are_made_once(small_gray_scene):
    view = masked(small_gray_scene.train[0])
    image, valid = THERMAL.tensors_of(view, CPU)
    assert np.shares_memory(image.numpy(), view.thermal) and np.array_equal(valid.numpy(), view.valid)
    assert not image[~valid].any()
    again = THERMAL.tensors_of(view, CPU)
    assert again[0] is image and again[1] is valid


def test_a_thermal_mask_says_nothing_about_rgb(small_gray_scene):
    view = masked(small_gray_scene.train[0])
    image, valid = RGB.tensors_of(view, CPU)
    assert valid is None and np.array_equal(image.numpy(), view.rgb)
    assert THERMAL.tensors_of(small_gray_scene.train[1], CPU)[1] is None


def view(side: int = 20) -> View:
    image = np.random.default_rng(side).random((side, side, 1)).astype(np.float32)
    return View("a", Camera(np.eye(3), np.eye(4), side, side), lambda: image)


def test_a_view_that_is_given_another_image_has_another_tensor():
    tensors, one = ViewTensors(), view()
    tensors.tensor(one, "thermal", torch.device("cpu"))
    one.thermal = np.full((20, 20, 1), np.nan, np.float32)
    assert tensors.tensor(one, "thermal", torch.device("cpu")).isnan().all()


def noisy(sigma: float) -> np.ndarray:
    """Return a ramp with a bright square, and noise."""
    y, x = np.mgrid[:96, :128] / 128
    image = 0.3 * x + 0.2 * y + 0.3 * ((x > 0.4) & (x < 0.6) & (y > 0.2) & (y < 0.5))
    return (image + np.random.default_rng(0).normal(0, sigma, image.shape))[..., None].astype(np.float32)


@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.1])
def test_noise_is_told_from_ramps_and_edges(sigma):
    assert noise_of(noisy(sigma)) == pytest.approx(sigma, rel=0.05)


def test_noise_is_at_least_that_of_8_bits():
    assert noise_of(noisy(0.0)) == noise_of(np.zeros((2, 2, 1), np.float32)) == QUANTISATION


def test_windows_with_a_masked_pixel_do_not_count():
    image, valid = noisy(0.02), np.ones((96, 128), bool)
    valid[:, ::2] = False
    assert noise_of(image, valid) == QUANTISATION  # no whole window is left
    valid[:, :64] = True
    image[:, 64:] += np.random.default_rng(1).normal(0, 0.5, (96, 64, 1))
    assert noise_of(image, valid) == pytest.approx(0.02, rel=0.1)


def test_the_typical_noise_is_a_median(small_gray_scene):
    views = [replace(small_gray_scene.train[0], load_thermal=lambda s=s: noisy(s)) for s in (0.01, 0.02, 0.5)]
    assert THERMAL.typical_noise(views) == pytest.approx(0.02, rel=0.05)
