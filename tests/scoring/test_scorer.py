"""Scores of rendered views, and of several views at once."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from tdgbench.scoring import RenderedImages, to_8bit
from tdgbench.scoring.metrics.psnr import psnr
from tdgbench.scoring.scorer import PIXELS_AT_ONCE, map_views
from tdgbench.splats.cpu import pool
from tests.helpers.configs import config


def scorer(*overrides):
    return instantiate(config("metrics.lpips.download=false", "metrics.lpips.net=alex", *overrides).metrics)


def score(scoring, scene, pixels, depth, rgb=None):
    """Scores of the first test view; the other views are shown as they are."""
    view = scene.test[0]
    renders = {v.name: RenderedImages(v.thermal, v.true_depth, {"rgb": v.rgb}) for v in scene.test}
    renders[view.name] = RenderedImages(
        pixels.astype(np.float32) / np.float32(255), depth, {} if rgb is None else {"rgb": rgb}
    )
    return scoring.score(scene, renders)[view.name]


@pytest.fixture(autouse=True)
def no_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))


def test_gray_scene(small_gray_scene):
    view = small_gray_scene.test[0]
    target = to_8bit(view.thermal)
    wrong = np.where(target < 128, target + 10, target - 10).astype(np.uint8)
    scoring = scorer()
    values = score(scoring, small_gray_scene, wrong, view.true_depth * 1.1)
    assert values["psnr"] == pytest.approx(-20 * np.log10(10 / 255))
    assert values["mae_degC"] == pytest.approx(10 / 255 * (50 - 14), rel=1e-5)
    assert values["mae_degC_without_offset"] <= values["mae_degC"]
    assert values["depth_abs_rel"] == pytest.approx(0.1, rel=1e-5)
    assert values["lpips"] is None and "download is false" in scoring.missing["lpips"]


def test_gray_in_three_channels_has_temperatures(small_gray_scene):
    view = small_gray_scene.test[0]
    target = to_8bit(view.thermal)
    wrong = np.where(target < 128, target + 10, target - 10).astype(np.uint8)
    three = replace(view, load_thermal=lambda: np.repeat(view.thermal, 3, axis=2))
    scene = replace(small_gray_scene, test=[three], channels=3)
    values = score(scorer(), scene, np.repeat(wrong, 3, axis=2), view.true_depth)
    assert values["mae_degC"] == pytest.approx(10 / 255 * (50 - 14), rel=1e-5)


def test_pseudo_color_has_no_temperature(small_scene):
    view = small_scene.test[0]
    scoring = scorer()
    values = score(scoring, small_scene, to_8bit(view.thermal), view.true_depth)
    assert values["mae_degC"] is None and "pseudo-colour" in scoring.missing["mae_degC"]
    assert values["ssim"] == pytest.approx(1)


def test_raw_counts_have_no_temperature(small_gray_scene):
    view = small_gray_scene.test[0]
    scene = replace(small_gray_scene, temperature=None, raw_count_range=(5500, 5830))
    scoring = scorer()
    values = score(scoring, scene, to_8bit(view.thermal), view.true_depth)
    assert values["mae_degC"] is None and scoring.missing["mae_degC"] == "raw counts have no °C"


def test_conventions_differ(small_scene):
    view = small_scene.test[0]
    wrong = np.roll(to_8bit(view.thermal), 3, axis=0)
    a, b = (score(scorer(f"metrics={name}"), small_scene, wrong, view.true_depth) for name in ("3dgs", "standard"))
    assert a["psnr"] == b["psnr"] and a["ssim"] != b["ssim"]


def test_the_published_backbone_through_the_options(vgg_weights):
    """`metrics.lpips.net=vgg metrics.lpips.weights=FILE`: the values that its README gives for these images."""
    g = torch.Generator().manual_seed(42)
    a, b = (torch.rand(2, 3, 100, 100, generator=g).permute(0, 2, 3, 1).numpy() for _ in range(2))
    scoring = scorer("metrics=standard", "metrics.lpips.net=vgg", f"metrics.lpips.weights={vgg_weights}")
    assert [scoring.lpips(*pair) for pair in zip(a, b, strict=True)] == pytest.approx([0.3582, 0.3456], abs=1e-4)
    in_unit_range = scorer("metrics.lpips.net=vgg", f"metrics.lpips.weights={vgg_weights}")  # as published tables
    assert in_unit_range.lpips((a[0] + 1) / 2, (b[0] + 1) / 2) != pytest.approx(0.3582, abs=1e-3)
    assert in_unit_range.lpips(a[0], a[0]) == 0


def test_scores_do_not_depend_on_the_number_of_threads(small_scene, squeeze_weights):
    rng = np.random.default_rng(0)
    renders = {
        view.name: RenderedImages(rng.random(view.thermal.shape, np.float32), view.true_depth)
        for view in small_scene.views
    }
    found = []
    for threads in (1, 2, 3):
        pool.set_threads(threads)
        scoring = instantiate(config("metrics.lpips.net=squeeze", f"metrics.lpips.weights={squeeze_weights}").metrics)
        scores = scoring.score(small_scene, renders)
        found.append((scores, scoring.score_train(small_scene.train, renders), scoring.missing))
    assert found[0] == found[1] == found[2]
    assert list(found[0][0]) == [view.name for view in small_scene.test] and len(found[0][0]) > 1
    assert found[0][1] == {v.name: scoring.score_train([v], renders)[v.name] for v in small_scene.train}


def test_an_rgb_model_is_scored_like_the_thermal_one(small_scene):
    view = small_scene.test[0]
    wrong = np.clip(view.rgb + 0.1, 0, 1)
    scoring = scorer()
    values = score(scoring, small_scene, to_8bit(view.thermal), view.true_depth, wrong)
    a, b = (to_8bit(image) / np.float32(255) for image in (wrong, view.rgb))
    assert values["rgb_psnr"] == pytest.approx(psnr(a, b)) and 10 < values["rgb_psnr"] < 30
    assert values["rgb_lpips"] is None and "download is false" in scoring.missing["rgb_lpips"]
    assert score(scoring, small_scene, to_8bit(view.thermal), view.true_depth)["rgb_ssim"] is None
    assert scoring.missing["rgb_ssim"] == "the method trains no RGB model"


@pytest.fixture(autouse=True)
def torch_has_its_threads_again():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_are_in_the_order_of_the_views(threads):
    pool.set_threads(threads)
    assert map_views(lambda view: view * view, range(23), pixels=1) == [n * n for n in range(23)]
    assert map_views(lambda view: view, [], pixels=0) == []


def test_views_are_worked_on_at_once_with_one_torch_thread_each():
    pool.set_threads(3)
    torch.set_num_threads(2)
    together = threading.Barrier(3, timeout=20)

    def work(view):
        together.wait()  # breaks unless three threads are here
        return torch.get_num_threads()

    assert map_views(work, range(3), pixels=1) == [1, 1, 1]
    assert torch.get_num_threads() == 2


def test_memory_bounds_the_views_at_once():
    pool.set_threads(8)
    busy, most, lock = [0], [0], threading.Lock()

    def work(view):
        with lock:
            busy[0] += 1
            most[0] = max(most[0], busy[0])
        np.ones(200_000).sum()
        with lock:
            busy[0] -= 1

    map_views(work, range(40), pixels=PIXELS_AT_ONCE // 2)
    assert most[0] <= 2
