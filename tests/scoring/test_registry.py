"""The metrics: found, described, and within their ranges; of each modality."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.bench.failures import message
from tdgbench.scenes.modalities import LABELS
from tdgbench.scoring import METRICS, RenderedImages, metrics, registry
from tdgbench.scoring.metric import ImageMetric, MetricError
from tdgbench.scoring.registry import find_metrics
from tdgbench.scoring.scored_view import Convention, ScoredView
from tdgbench.scoring.scorer import _scored
from tests.helpers.configs import config

MADE_UP = """
from tdgbench.scoring.metric import ImageMetric

METRIC = ImageMetric(name="bias", label="bias", of_images=lambda pair: float((pair.image - pair.target).mean()))
"""


def test_a_file_is_a_metric(tmp_path, monkeypatch):
    monkeypatch.setattr(metrics, "__path__", [*metrics.__path__, str(tmp_path)])
    (tmp_path / "made_up_bias.py").write_text(MADE_UP)
    assert list(find_metrics()) == [*METRICS, "bias"]
    (tmp_path / "made_up_empty.py").write_text("")
    with pytest.raises(TypeError, match="made_up_empty defines no metric"):
        find_metrics()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("BIAS", "BIAS is no MODULE.NAME; of the modules here it may be biases.BIAS"),
        ("biases", "it may be biases.NAME"),
        ("biases.METRC", "did you mean METRIC?"),
        ("biasses.METRIC", "did you mean biases?"),
        ("biases.SPACED", "metric 'a b': a name has letters, digits and underscores"),
        ("biases.PSNR", "there is another metric psnr"),
        ("broken.METRIC", "cannot be imported (OSError: no camera)"),
        ("elsewhere.METRIC", "run this in its folder, or install it"),
    ],
)
def test_mistyped_metrics_of_the_user(tmp_path, monkeypatch, name, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    others = "from tdgbench.scoring.metrics.psnr import PSNR\nfrom dataclasses import replace\n"
    (tmp_path / "biases.py").write_text(f"{MADE_UP}{others}SPACED = replace(METRIC, name='a b')\n")
    (tmp_path / "broken.py").write_text("raise OSError('no camera')")
    with pytest.raises(ValueError, match=re.escape(said)):
        registry.extra_metrics([name])


def test_a_new_modality_has_the_metrics_of_every_modality(monkeypatch):
    monkeypatch.setitem(LABELS, "nir", "NIR")
    monkeypatch.setattr(registry, "OTHERS", ("rgb", "nir"))
    found = find_metrics()
    assert set(found) - set(METRICS) == {"nir_psnr", "nir_ssim", "nir_lpips"}
    assert found["nir_ssim"].title == "SSIM of the NIR model ↑" and found["nir_ssim"].modality == "nir"


COLUMNS = ["psnr", "ssim", "lpips", "channel_psnr", "psnr_affine", "psnr_right_half", "psnr_true",
           "rgb_psnr", "rgb_ssim", "rgb_lpips", "mae_degC", "mae_degC_without_offset", "depth_abs_rel", "floaters",
           "depth_inconsistency", "barely_seen"]  # fmt: skip


def test_columns_of_views_csv():
    assert list(METRICS) == COLUMNS
    assert all(metric.label and metric.meaning for metric in METRICS.values())
    assert [name for name, metric in METRICS.items() if metric.higher_is_better] == [
        name for name in COLUMNS if "psnr" in name or "ssim" in name
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


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (float("nan"), "is nan: return a finite number, or raise NotApplicableError"),
        (float("inf"), "is inf: cap it"),
        (-0.1, "is -0.1, outside its limits 0 to inf: mend it, declare limits=(LOW, HIGH)"),
        (None, "is of type NoneType: return a float"),
    ],
)
def test_values_that_count_for_nothing_are_refused(small_gray_scene, value, said):
    view = small_gray_scene.test[0]
    metric = ImageMetric(name="bias", label="bias", of_images=lambda pair: value)
    shown = ScoredView(view, RenderedImages(view.thermal, None), Convention("zero", float))
    with pytest.raises(MetricError, match=re.escape(f"metric bias of view {view.name} {said}")):
        metric.score(shown)
    with pytest.raises(ZeroDivisionError) as caught:
        replace(metric, of_images=lambda pair: 1 / 0).score(shown)
    assert message(caught.value) == f"ZeroDivisionError: division by zero; metric bias of view {view.name}"
    scores, missing = _scored(shown, [replace(metric, of_images=lambda pair: 1 / 0)])  # one of the user
    assert scores == {"bias": None} and missing["bias"].startswith(
        "failed: ZeroDivisionError: division by zero; metric"
    )
    assert missing["bias"].rpartition(", line")[0].endswith("(test_registry.py")


def test_the_rgb_model_is_described_like_the_thermal_one():
    psnr, rgb = METRICS["psnr"], METRICS["rgb_psnr"]
    assert (rgb.digits, rgb.unit, rgb.higher_is_better) == (psnr.digits, psnr.unit, True)
    assert rgb.title == "PSNR of the RGB model, dB ↑" and psnr.in_main_table and not rgb.in_main_table
    train = psnr.of_training_views()
    assert train.name == "train_psnr" and train.title == "PSNR of the training views, dB ↑"
