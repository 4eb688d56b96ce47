from dataclasses import replace

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from tdgbench.scenes.scene import PALETTE, TemperatureRange
from tdgbench.scoring import RenderedImages
from tdgbench.scoring.metrics.temperature import mae_degC, psnr_true
from tdgbench.scoring.scored_view import Convention, NotApplicableError, ScoredView


def scores(scene, images) -> dict[str, float]:
    renders = {name: RenderedImages(image, np.zeros(image.shape[:2])) for name, image in images.items()}
    convention = Convention("reflect", lambda image, target: 0.0)
    shown = (ScoredView(view, renders[view.name], convention, scene, renders) for view in scene.test)
    return {one.view.name: psnr_true(one) for one in shown}


def as_images(scene, gain=1.0, offset=0.0):
    """True temperatures as images of a camera with another scale and zero."""
    low, span = scene.temperature.min, scene.temperature.max - scene.temperature.min
    true = {view.name: (view.true_temperature - low) / span for view in scene.test}
    return {name: (gain * one + offset)[..., None].astype(np.float32) for name, one in true.items()}


def test_errors_of_channels_do_not_cancel(small_gray_scene):
    """Three channels that are 10 levels too high, too low, and right."""
    view = small_gray_scene.test[0]
    truth = np.repeat(np.round(view.thermal * 200 + 20) / 255, 3, axis=2).astype(np.float32)
    scene = replace(small_gray_scene, temperature=TemperatureRange(10.0, 46.0))
    shown = replace(view, load_thermal=lambda: truth)
    render = RenderedImages(truth + np.array([10, -10, 0], np.float32) / 255, np.zeros(truth.shape[:2]))
    found = mae_degC(ScoredView(shown, render, Convention("zero", lambda image, target: 0.0), scene, {}))
    assert found == pytest.approx(36 * 20 / 3 / 255, rel=1e-3)


def test_truth_is_best_whatever_its_scale_and_zero(small_gray_scene):
    for response in ((1.0, 0.0), (0.8, 0.1)):
        assert min(scores(small_gray_scene, as_images(small_gray_scene, *response)).values()) > 90


def test_an_error_is_measured_by_the_span_of_all_test_views(small_gray_scene):
    rng, images = np.random.default_rng(0), as_images(small_gray_scene, 0.8, 0.1)
    truth = [view.true_temperature for view in small_gray_scene.test]
    span = max(one.max() for one in truth) - min(one.min() for one in truth)
    noisy = {name: image + rng.normal(0, 0.01, image.shape).astype(np.float32) for name, image in images.items()}
    scale = (small_gray_scene.temperature.max - small_gray_scene.temperature.min) / 0.8
    expected = peak_signal_noise_ratio(np.zeros(9), np.full(9, 0.01 * scale), data_range=span)
    assert np.mean(list(scores(small_gray_scene, noisy).values())) == pytest.approx(expected, abs=0.2)


def test_views_that_drift_apart_are_worse(small_gray_scene):
    images = as_images(small_gray_scene, 0.8, 0.1)
    first = next(iter(images))
    images[first] = images[first] + np.float32(0.05)
    assert min(scores(small_gray_scene, images).values()) < 35


def test_it_is_not_measured_without_truth(small_gray_scene, small_scene):
    with pytest.raises(NotApplicableError, match="no true temperatures"):
        unknown = [replace(view, load_true_temperature=None) for view in small_gray_scene.test]
        scores(replace(small_gray_scene, test=unknown), as_images(small_gray_scene))
    with pytest.raises(NotApplicableError, match="pseudo-colour"):
        scores(small_scene, {view.name: view.thermal for view in small_scene.test})
    with pytest.raises(NotApplicableError, match="pseudo-colour"):  # made gray
        made_gray = replace(small_gray_scene, assumed={"values": PALETTE})
        scores(made_gray, as_images(made_gray))
    with pytest.raises(NotApplicableError, match="another size"):
        scores(small_gray_scene, {view.name: view.thermal[1:] for view in small_gray_scene.test})


def test_masked_pixels_have_no_part(small_gray_scene):
    valid = np.ones((36, 48), bool)
    valid[:, :8] = False
    scene = replace(small_gray_scene, test=[replace(view, load_valid=lambda: valid) for view in small_gray_scene.test])
    images = as_images(small_gray_scene, 0.8, 0.1)
    spoilt = {name: np.where(valid[..., None], image, np.float32(1)) for name, image in images.items()}
    assert scores(scene, spoilt) == scores(scene, images) and min(scores(scene, images).values()) > 90
