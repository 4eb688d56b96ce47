"""Scores of masked views: over valid pixels alone, checked against scikit-image and against sums by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hydra.utils import instantiate
from skimage.metrics import structural_similarity

from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scoring import METRICS, RenderedImages, to_8bit
from tdgbench.scoring.metrics.depth import depth_inconsistency
from tdgbench.scoring.metrics.ssim import ssim
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView
from tests.helpers.configs import config
from tests.helpers.masks import masks, with_garbage
from tests.scoring.images import images

SIZES = [(40, 50, 3), (33, 27, 1)]
SETTINGS = {
    "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0, "channel_axis": 2,
}  # fmt: skip


def spoilt(image, valid, seed):
    """The image with garbage at masked pixels."""
    return np.where(valid[..., None], image, np.random.default_rng(seed).random(image.shape))


@pytest.mark.parametrize("size", SIZES)
def test_3dgs_ssim_takes_masked_pixels_as_outside_the_image(size):
    """scikit-image's map of the images in a black surrounding, which the masked pixels are as well."""
    a, b = (image.astype(np.float64) for image in images(size))
    pad = ((20, 20), (20, 20), (0, 0))
    for name, valid in masks(*size[:2]).items():
        black = [np.pad(np.where(valid[..., None], one, 0.0), pad) for one in (a, b)]
        _, full = structural_similarity(*black, full=True, **SETTINGS)
        expected = full[20:-20, 20:-20][valid].mean()
        found = ssim(spoilt(a, valid, 1), spoilt(b, valid, 2), "zero", valid)
        assert found == pytest.approx(expected, abs=1e-6), name


@pytest.mark.parametrize("size", SIZES)
def test_standard_ssim_takes_windows_of_valid_pixels_alone(size):
    """scikit-image's map of the images with garbage, where no window reaches it."""
    a, b = (image.astype(np.float64) for image in images(size))
    reached = 0
    for name, valid in masks(*size[:2]).items():
        x, y = spoilt(a, valid, 1), spoilt(b, valid, 2)
        _, full = structural_similarity(x, y, full=True, **SETTINGS)
        fits = [(i, j) for i in range(5, size[0] - 5) for j in range(5, size[1] - 5)
                if valid[i - 5 : i + 6, j - 5 : j + 6].all()]  # fmt: skip
        if fits:
            expected = np.mean([full[i, j] for i, j in fits])
            assert ssim(x, y, "valid", valid) == pytest.approx(expected, abs=1e-6), name
            reached += 1
        else:
            with pytest.raises(NotApplicableError, match="no window of 11×11 px holds only pixels with a thermal"):
                ssim(x, y, "valid", valid)
    assert reached >= 2


def masked_test_views(scene, seed):
    """The scene with a mask at random on every test view, and renders that are wrong everywhere."""
    rng = np.random.default_rng(seed)
    test = [with_garbage(view, rng.random((36, 48)) < 0.8, np.nan) for view in scene.test]
    renders = {
        view.name: RenderedImages(
            np.where(view.valid[..., None], clean.thermal + rng.normal(0, 0.1, clean.thermal.shape), garbage).astype(
                np.float32
            ),
            np.where(view.valid, clean.true_depth * 1.2, garbage).astype(np.float32),
        )
        for view, clean, garbage in zip(test, scene.test, (1e6, -3.0), strict=True)
    }
    return replace(scene, test=test, temperature=TemperatureRange(10.0, 30.0)), renders


@pytest.mark.parametrize("scene_of", ["small_scene", "small_gray_scene"])
def test_scores_by_hand(scene_of, request):
    scene, renders = masked_test_views(request.getfixturevalue(scene_of), 5)
    scorer = instantiate(config("metrics.lpips.download=false").metrics)
    scores = scorer.score(scene, renders)
    for view in scene.test:
        found, valid = scores[view.name], view.valid
        image, target = renders[view.name].image[valid], view.load_thermal()[valid]
        a, b = (to_8bit(one).astype(float) / 255 for one in (image, target))
        assert found["psnr"] == pytest.approx(-10 * np.log10(((a - b) ** 2).mean()), abs=1e-5)
        mse = ((np.clip(image, 0, 1).astype(float) - target) ** 2).mean(axis=0)
        assert found["channel_psnr"] == pytest.approx(np.mean(-10 * np.log10(mse)), abs=1e-5)
        if scene.channels == 1:
            assert found["mae_degC"] == pytest.approx(20 * np.abs(a - b).mean(), rel=1e-5)
            around = np.abs(a - b - np.median(a - b)).mean()
            assert found["mae_degC_without_offset"] == pytest.approx(20 * around, rel=1e-5)
        assert found["depth_abs_rel"] == pytest.approx(0.2, rel=1e-5) and found["floaters"] == 0
        assert scorer.score_train([view], renders)[view.name] == {m: found[m] for m in ("psnr", "ssim")}


def test_depths_at_masked_pixels_are_not_compared(small_gray_scene):
    """Neither those of the view nor those of its neighbour."""
    scene, renders = masked_test_views(small_gray_scene, 6)
    one, other = scene.test
    scores = instantiate(config("metrics.lpips.download=false").metrics).score(scene, renders)
    depths = [np.where(view.valid, renders[view.name].depth, 0) for view in (one, other)]
    expected = depth_inconsistency(depths[0], one.camera, depths[1], other.camera)
    assert scores[one.name]["depth_inconsistency"] == expected is not None


def test_lpips_sees_no_difference_at_masked_pixels(small_gray_scene, squeeze_weights):
    view = small_gray_scene.test[0]
    valid = masks(36, 48)["a corner"]
    options = ("metrics.lpips.net=squeeze", f"metrics.lpips.weights={squeeze_weights}")
    scorer = instantiate(config(*options).metrics)

    def lpips(garbage, wrong):
        masked = with_garbage(view, valid, garbage)
        image = np.where(valid[..., None], np.clip(view.thermal + wrong, 0, 1), 0.3).astype(np.float32)
        return METRICS["lpips"].score(ScoredView(masked, RenderedImages(image, view.true_depth), scorer.settings))

    assert lpips(np.nan, 0.0) == 0.0 and lpips(np.nan, 0.2) == lpips(1.0, 0.2) > 0.001
    black = [np.where(valid[..., None], one, 0) for one in (np.clip(view.thermal + 0.2, 0, 1), view.thermal)]
    eight_bit = [to_8bit(one).astype(np.float32) / np.float32(255) for one in black]
    assert lpips(np.nan, 0.2) == pytest.approx(scorer.lpips(*eight_bit), rel=1e-6)


def test_a_view_without_a_valid_pixel_has_no_score(small_gray_scene):
    scene, renders = masked_test_views(small_gray_scene, 7)
    nothing = with_garbage(scene.test[1], np.zeros((36, 48), bool), np.nan)
    scene = replace(scene, test=[scene.test[0], nothing])
    scorer = instantiate(config("metrics.lpips.download=false").metrics)
    scores = scorer.score(scene, renders)
    for name in ("psnr", "ssim", "channel_psnr", "mae_degC", "depth_abs_rel", "floaters"):
        assert scores[nothing.name][name] is None and scores[scene.test[0].name][name] is not None
        assert scorer.missing[name] == f"no pixel of view {nothing.name} has a thermal value: its mask leaves none"
