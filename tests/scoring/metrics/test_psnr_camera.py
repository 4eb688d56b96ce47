from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scoring import RenderedImages
from tdgbench.scoring.metrics.psnr import psnr
from tdgbench.scoring.metrics.psnr_camera import psnr_camera
from tdgbench.scoring.scored_view import Convention, NotApplicableError, ScoredView, as_saved

CONVENTION = Convention("zero", lambda image, target: 0.0)


def score(view, image, added) -> float:
    return psnr_camera(ScoredView(view, RenderedImages(image, np.zeros(image.shape[:2]), added=added), CONVENTION))


def vignette(view) -> np.ndarray:
    down, across = np.mgrid[-1 : 1 : view.camera.height * 1j, -1 : 1 : view.camera.width * 1j]
    return 0.05 * (down**2 + across**2)


def test_a_vignette_that_training_removed_is_seen_again(small_gray_scene):
    view = small_gray_scene.test[0]
    added = vignette(view)
    without = view.thermal - added[..., None].astype(np.float32)
    assert score(view, without, added) > 60 > 35 > psnr(as_saved(without), as_saved(view.thermal))


def test_an_ideal_camera_adds_nothing(small_gray_scene):
    view = small_gray_scene.test[0]
    image = view.thermal + np.random.default_rng(0).normal(0, 0.1, view.thermal.shape).astype(np.float32)
    assert score(view, image, np.zeros(image.shape[:2])) == psnr(as_saved(image), as_saved(view.thermal))


def test_channels_get_the_same(small_scene):
    view = small_scene.test[0]
    added = vignette(view)
    assert score(view, view.thermal - added[..., None].astype(np.float32), added) > 60


def test_masked_pixels_have_no_part(small_gray_scene):
    valid = np.ones((36, 48), bool)
    valid[:, :8] = False
    view = replace(small_gray_scene.test[0], load_valid=lambda: valid)
    added = vignette(view)
    image = view.thermal - added[..., None].astype(np.float32)
    spoilt = np.where(valid[..., None], image, np.float32(1))
    assert score(view, spoilt, added) == score(view, image, added)


def test_an_unknown_camera_has_no_score(small_gray_scene):
    view = small_gray_scene.test[0]
    with pytest.raises(NotApplicableError, match="unknown"):
        score(view, view.thermal, None)
