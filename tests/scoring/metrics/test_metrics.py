"""Every metric is described, and its scores lie in its range."""

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.scoring import METRICS, RenderedImages
from tests.helpers.configs import config

COLUMNS = ["psnr", "ssim", "lpips", "channel_psnr", "psnr_affine", "psnr_right_half", "psnr_true",
           "rgb_psnr", "rgb_ssim", "rgb_lpips", "mae_degC", "mae_degC_without_offset", "depth_abs_rel", "floaters",
           "depth_inconsistency", "barely_seen", "psnr_well_seen", "psnr_barely_seen", "guess_correlation"]  # fmt: skip


def test_columns_of_views_csv():
    assert list(METRICS) == COLUMNS
    assert all(metric.label and metric.meaning for metric in METRICS.values())
    assert [name for name, metric in METRICS.items() if metric.higher_is_better] == [
        name for name in COLUMNS if "psnr" in name or "ssim" in name or name == "guess_correlation"
    ]


@pytest.mark.parametrize("scene", ["small_scene", "small_gray_scene"])
def test_scores_lie_in_their_range(scene, request, squeeze_weights):
    scene = request.getfixturevalue(scene)
    scorer = instantiate(config("metrics.lpips.net=squeeze", f"metrics.lpips.weights={squeeze_weights}").metrics)
    rng = np.random.default_rng(0)

    def wrong(view):
        noise = rng.normal(0, 0.2, view.thermal.shape).astype(np.float32)
        return RenderedImages(view.thermal + noise, view.true_depth * rng.uniform(0.5, 1.5), {"rgb": 1 - view.rgb})

    views = scorer.score(scene, {view.name: wrong(view) for view in scene.test})
    scored = {name for scores in views.values() for name, value in scores.items() if value is not None}
    assert scored == set(COLUMNS) - set(scorer.missing)
    for scores in views.values():
        for name, value in scores.items():
            low, high = METRICS[name].limits
            assert value is None or low <= value <= high, name
