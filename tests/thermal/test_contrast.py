from dataclasses import replace

import numpy as np
import pytest
from skimage import exposure

from tdgbench.scenes import SceneError
from tdgbench.thermal.contrast import _clahe, with_contrast
from tests.helpers.drift import drift, with_response

ALL = ["percentile", "sequence", "clahe", "bbhe", "cdf"]


def gray(view) -> np.ndarray:
    return view.thermal[..., 0].astype(np.float64)


def changed(scene, contrast):
    """Pairs of images (H, W), before and after, of all views."""
    return [(gray(a), gray(b)) for a, b in zip(scene.views, with_contrast(scene, contrast).views, strict=True)]


@pytest.mark.parametrize("contrast", ALL)
def test_images_stay_images_and_hot_stays_hot(small_gray_scene, contrast):
    scene = with_contrast(small_gray_scene, contrast)
    assert scene.fingerprint != small_gray_scene.fingerprint and len(scene.views) == len(small_gray_scene.views)
    for before, after in changed(small_gray_scene, contrast):
        assert after.shape == before.shape and after.min() >= 0 and after.max() <= 1
        assert np.corrcoef(before.ravel(), after.ravel())[0, 1] > 0.6
        if contrast != "clahe":  # local: values are compared within a tile alone
            order = np.argsort(before.ravel(), kind="stable")
            assert (np.diff(after.ravel()[order]) >= -1e-6).all()


def test_none_is_the_scene_itself(small_gray_scene):
    assert with_contrast(small_gray_scene, "none") is small_gray_scene


def test_percentile_is_that_of_scikit_image(small_gray_scene):
    for before, after in changed(small_gray_scene, "percentile"):
        ends = tuple(np.percentile(before, (1, 99)))
        assert after == pytest.approx(exposure.rescale_intensity(before, in_range=ends, out_range=(0, 1)), abs=1e-6)


def test_sequence_is_one_stretch_that_keeps_temperatures(small_gray_scene):
    scene = with_contrast(small_gray_scene, "sequence")
    ends = np.percentile(np.concatenate([gray(view).ravel() for view in small_gray_scene.train]), (1, 99))
    for before, after in changed(small_gray_scene, "sequence"):
        expected = exposure.rescale_intensity(before, in_range=tuple(ends), out_range=(0, 1))
        assert after == pytest.approx(expected, abs=1e-6)
        old, new = small_gray_scene.temperature, scene.temperature
        inside = (after > 0) & (after < 1)
        degC = old.min + (old.max - old.min) * before
        assert (new.min + (new.max - new.min) * after)[inside] == pytest.approx(degC[inside], abs=1e-3)


def test_clahe_is_that_of_scikit_image(small_gray_scene):
    for before, after in changed(small_gray_scene, "clahe"):
        stretched = (before - before.min()) / np.ptp(before)
        assert after == pytest.approx(exposure.equalize_adapthist(stretched), abs=1e-5)


def test_bbhe_equalises_both_sides_of_the_mean(small_gray_scene):
    for before, after in changed(small_gray_scene, "bbhe"):
        mean = before.mean()
        for side, (low, high) in ((before <= mean, (before.min(), mean)), (before > mean, (mean, before.max()))):
            values = (before[side] - low) / (high - low)
            counts, centres = exposure.cumulative_distribution(values.reshape(-1, 1), 256)
            expected = low + (high - low) * np.interp(values, centres, counts)
            assert np.median(np.abs(after[side] - expected)) < 0.01


def test_cdf_gives_all_views_the_same_histogram(small_gray_scene):
    scene = with_response(small_gray_scene, drift(8, 0.05), 1 + drift(8, 0.1, seed=1))
    spread = [np.std([np.quantile(one, u) for one in images]) for u in (0.1, 0.5, 0.9)
              for images in ([gray(view) for view in scene.train],)]  # fmt: skip
    after = [gray(view) for view in with_contrast(scene, "cdf").train]
    left = [np.std([np.quantile(one, u) for one in after]) for u in (0.1, 0.5, 0.9)]
    assert max(left) < 0.1 * min(spread)
    matched = exposure.match_histograms(gray(scene.train[0]), after[1])
    assert np.abs(after[0] - matched).mean() < 0.01


def test_cdf_undoes_a_drift_of_equal_images(small_gray_scene):
    one = small_gray_scene.train[0]
    same = [replace(view, load_thermal=lambda: one.thermal) for view in small_gray_scene.train]
    scene = with_response(replace(small_gray_scene, train=same), drift(8, 0.05), 1 + drift(8, 0.1, seed=1))
    images = np.array([gray(view) for view in with_contrast(scene, "cdf").train])
    assert np.abs(images - images[0]).max() < 0.01


@pytest.mark.parametrize("contrast", ALL)
def test_masked_pixels_have_no_part(small_gray_scene, contrast):
    def masked(view, value):
        valid = np.ones((36, 48), bool)
        valid[:, :20] = False
        image = np.where(valid[..., None], view.thermal, np.float32(value))
        return replace(view, load_thermal=lambda: image, load_valid=lambda: valid)

    scenes = [
        replace(small_gray_scene, train=[masked(view, value) for view in small_gray_scene.train])
        for value in (0.0, 1.0)
    ]
    first, second = ([view.thermal for view in with_contrast(scene, contrast).train] for scene in scenes)
    assert np.array_equal(first, second) and not np.any(np.array(first)[:, :, :20])


@pytest.mark.parametrize("contrast", ALL)
def test_a_flat_image_stays_finite(small_gray_scene, contrast):
    flat = np.full((36, 48, 1), 0.25, np.float32)
    views = [replace(view, load_thermal=lambda: flat) for view in small_gray_scene.train]
    scene = with_contrast(replace(small_gray_scene, train=views), contrast)
    assert np.isfinite(scene.train[0].thermal).all()


def test_pseudo_colour_is_an_error(small_scene):
    with pytest.raises(SceneError, match="orbit: thermal images are pseudo-coloured"):
        with_contrast(small_scene, "clahe")


def test_clahe_sees_the_nearest_valid_pixels_in_the_place_of_masked_ones():
    rng = np.random.default_rng(0)
    image, valid = rng.uniform(0.3, 0.7, (40, 56)), np.ones((40, 56), bool)
    valid[:, :20] = False
    filled = [np.where(valid, image, fill) for fill in (0.0, 1.0)]
    first, second = (_clahe(one, valid) for one in filled)
    assert np.array_equal(first, second)
    nearest = np.where(valid, image, image[:, 20:21])
    expected = exposure.equalize_adapthist((nearest - nearest.min()) / np.ptp(nearest))
    assert first[valid] == pytest.approx(expected[valid], abs=1e-9)


def test_cdf_gives_equal_values_the_mean_of_their_quantiles(small_gray_scene):
    """Values that one view clips, and others do not."""

    def clipped(view, share):
        high = np.quantile(view.thermal, 1 - share)
        return replace(view, load_thermal=lambda: np.minimum(view.thermal, np.float32(high)))

    views = [clipped(view, 0.4 if index == 0 else 0.05) for index, view in enumerate(small_gray_scene.train)]
    scene = replace(small_gray_scene, train=views)
    before, after = gray(scene.train[0]), gray(with_contrast(scene, "cdf").train[0])
    others = np.mean([np.quantile(gray(view), np.linspace(0, 1, 257)) for view in scene.train], axis=0)
    assert after[before == before.max()].mean() == pytest.approx(others[-103:].mean(), abs=0.01)
