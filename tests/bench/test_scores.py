import numpy as np
import pytest
from hydra.utils import instantiate
from PIL import Image

from tdgbench.bench.scores import score_training_views, score_views
from tdgbench.cells.cell_tables import read_log, read_views, write_log, write_views
from tdgbench.cells.record import read_all
from tdgbench.scoring.lpips import LPIPS
from tdgbench.training.loop import LogLine, TrainingLog
from tests.helpers.configs import config
from tests.helpers.training import ready_to_train


def test_scores_of_test_and_training_views(small_gray_scene, tmp_path):
    trainer = ready_to_train(small_gray_scene, "3dgs", 3)
    scorer = instantiate(config("metrics.lpips.download=false").metrics)
    scores = score_views(trainer, small_gray_scene, scorer)
    assert list(scores) == [view.name for view in small_gray_scene.test]
    train = score_training_views(trainer, small_gray_scene, scorer)
    assert set(train) == {"psnr", "ssim"} and 0 < train["psnr"] < 60
    write_views(tmp_path, scores)
    assert read_views(tmp_path) == scores and {row["rgb_psnr"] for row in scores.values()} == {None}


def test_lpips_with_the_published_backbone(tiny_cell, vgg_weights):
    """`metrics.lpips.net=vgg metrics.lpips.weights=FILE`: LPIPS of the pictures that a cell leaves."""
    assert tiny_cell("metrics.lpips.net=vgg", f"metrics.lpips.weights={vgg_weights}").status == "ok"
    metric = LPIPS("vgg", "unit", str(vgg_weights))

    def picture(path):
        return np.asarray(Image.open(path), np.float32).reshape(36, 48, -1) / 255

    renders = sorted((tiny_cell.folder / "renders").glob("*.png"))
    found = [metric(picture(path), picture(tiny_cell.folder / "targets" / path.name)) for path in renders]
    (record,) = read_all(tiny_cell.experiment)
    assert len(found) == 2 and record.scores["lpips"] == pytest.approx(np.mean(found), abs=1e-6)
    assert "lpips" not in record.missing


def test_one_row_per_line_and_one_column_per_term(tmp_path):
    lines = [LogLine(1, 0.12345, 0.5, 20.0, 10, {"b": 1.0}), LogLine(2, 1.0, 0.25, 21.0, 12, {"a": 2.0, "b": 3.0})]
    write_log(tmp_path, TrainingLog(lines))
    assert (tmp_path / "log.csv").read_text().splitlines() == [
        "iteration,seconds,loss,smoothed_psnr,gaussians,loss_a,loss_b",
        "1,0.123,0.5,20.0,10,,1.0",
        "2,1.0,0.25,21.0,12,2.0,3.0",
    ]
    assert [row.get("loss_a") for row in read_log(tmp_path)] == [None, 2.0]
