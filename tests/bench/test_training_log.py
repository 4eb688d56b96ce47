import sys

import numpy as np
import pytest
from rich.console import Console

from tdgbench.bench.cell import run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.training_log import TensorBoardLog, write_log
from tdgbench.training.loop import LogLine, TrainingLog
from tests.helpers.configs import SMALL, config


def events(folder):
    """scalars: name → [(step, value)]; names of images."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(folder)).Reload()
    scalars = {tag: [(e.step, e.value) for e in found.Scalars(tag)] for tag in found.Tags()["scalars"]}
    return scalars, found.Tags()["images"]


def test_a_cell_writes_curves_scores_and_pictures(tmp_path, data_root):
    pytest.importorskip("tensorboard")
    cfg = config(
        *SMALL, "log=tensorboard", "budget=demo", "budget.iterations=30", "prior=synthetic", "scene=turntable",
        f"data.root={data_root}", f"results={tmp_path}",
    )  # fmt: skip
    assert run_cell(cfg, "", CellProgress(Console(quiet=True), 30)).status == "ok"
    folder = tmp_path / "single" / "tensorboard" / "tdg" / "synthetic" / "turntable" / "colmap" / "seed0"
    scalars, images = events(folder)
    assert [step for step, _ in scalars["training/loss"]] == list(range(1, 31))
    assert {"training/train_psnr", "training/gaussians", "training/loss_depth", "test/psnr"} <= set(scalars)
    assert len(images) == 2
    assert run_cell(cfg, "", CellProgress(Console(quiet=True), 30)).status == "kept"  # how it is logged is no setting


def test_events_after_the_checkpoint_of_a_killed_training_are_dropped(tmp_path):
    pytest.importorskip("tensorboard")

    def write(after, upto, value):
        log = TensorBoardLog(tmp_path / "cell", after)
        for iteration in range(after + 1, upto + 1):
            log.line(LogLine(iteration, 0.0, value, 20.0, 5, {}))
        log.results(upto, {"psnr": 20.0, "lpips": None}, {"a": np.zeros((4, 4, 1), np.uint8)})
        log.close()

    write(0, 4, 1.0)
    write(2, 6, 2.0)
    scalars, _ = events(tmp_path / "cell")
    assert scalars["training/loss"] == [(1, 1.0), (2, 1.0), (3, 2.0), (4, 2.0), (5, 2.0), (6, 2.0)]
    assert "test/lpips" not in scalars
    write(0, 1, 3.0)  # from the beginning
    assert events(tmp_path / "cell")[0]["training/loss"] == [(1, 3.0)]


def test_the_error_without_tensorboard_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(RuntimeError, match=r"pip install -e '.\[tensorboard\]'"):
        TensorBoardLog(tmp_path, 0)


def test_one_row_per_line_and_one_column_per_term(tmp_path):
    lines = [LogLine(1, 0.12345, 0.5, 20.0, 10, {"b": 1.0}), LogLine(2, 1.0, 0.25, 21.0, 12, {"a": 2.0, "b": 3.0})]
    write_log(tmp_path / "log.csv", TrainingLog(lines))
    assert (tmp_path / "log.csv").read_text().splitlines() == [
        "iteration,seconds,loss,train_psnr,gaussians,loss_a,loss_b",
        "1,0.123,0.5,20.0,10,,1.0",
        "2,1.0,0.25,21.0,12,2.0,3.0",
    ]
