import numpy as np
import pytest

from tdgbench.scoring import METRICS, RenderedImages
from tdgbench.scoring.scored_view import Convention, NotApplicableError, ScoredView


def test_the_rgb_model_is_described_like_the_thermal_one():
    psnr, rgb = METRICS["psnr"], METRICS["rgb_psnr"]
    assert (rgb.digits, rgb.unit, rgb.higher_is_better) == (psnr.digits, psnr.unit, True)
    assert rgb.title == "PSNR of the RGB model, dB ↑" and psnr.in_main_table and not rgb.in_main_table
    train = psnr.of_training_views()
    assert train.name == "train_psnr" and train.title == "PSNR of the training views, dB ↑"


def test_a_metric_reads_its_own_modality(small_scene):
    view = small_scene.test[0]
    images = RenderedImages(view.thermal, view.true_depth, {"rgb": np.clip(view.rgb + 0.1, 0, 1)})
    shown = ScoredView(view, images, Convention("zero", lambda a, b: 0.0))
    assert METRICS["psnr"].score(shown) > 99 and METRICS["rgb_psnr"].score(shown) < 30
    without = ScoredView(view, RenderedImages(view.thermal, view.true_depth), shown.convention)
    with pytest.raises(NotApplicableError, match="trains no RGB model"):
        METRICS["rgb_psnr"].score(without)
