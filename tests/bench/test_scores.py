import csv

import pytest
from hydra.utils import instantiate

from tdgbench.bench.scores import score_training_views, score_views, write_views
from tests.helpers.configs import config
from tests.helpers.training import ready_to_train


def test_scores_of_test_and_training_views(small_gray_scene, tmp_path):
    method, _ = ready_to_train(small_gray_scene, "splat", 3)
    scorer = instantiate(config("metrics.lpips.download=false").metrics)
    scores = score_views(method, small_gray_scene, scorer)
    assert list(scores) == [view.name for view in small_gray_scene.test]
    train = score_training_views(method, small_gray_scene, scorer)
    assert set(train) == {"psnr", "ssim"} and 0 < train["psnr"] < 60
    write_views(tmp_path / "views.csv", scores)
    rows = list(csv.DictReader((tmp_path / "views.csv").open()))
    assert [row["view"] for row in rows] == list(scores)
    for row in rows:
        assert float(row["psnr"]) == pytest.approx(scores[row["view"]]["psnr"])
        assert row["rgb_psnr"] == "n/a"
