import pytest
from rich.console import Console

from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.bench.run_cell import run_cell
from tdgbench.verify import verify
from tests.helpers.configs import SMALL, config


@pytest.fixture
def record_of(data_root, tmp_path):
    def run(*overrides):
        cfg = config(
            *SMALL, "budget=demo", "budget.iterations=30", "scene=turntable", f"data.root={data_root}",
            f"results={tmp_path}", *overrides,
        )  # fmt: skip
        outcome = run_cell(cfg, "", CellProgress(Console(quiet=True), 30))
        assert outcome.status == "ok", outcome
        (record,) = read_all(tmp_path / "single")
        assert verify(tmp_path / "single") == (1, 1, [])
        return record

    return run


def test_training_and_test_images_are_changed(record_of):
    before = record_of("method=3dgs")
    after = record_of("method=3dgs", "contrast.training=clahe")
    assert after.key != before.key and after.scores["psnr"] != before.scores["psnr"]
    assert before.temperature_range and after.temperature_range is None and after.scores["mae_degC"] is None
    assert "contrast: images are trained on and scored with contrast.training=clahe" in after.notes
    kept = record_of("method=3dgs", "contrast.training=sequence")
    assert kept.temperature_range is not None and kept.scores["mae_degC"] is not None
