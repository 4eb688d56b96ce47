import pytest

from tdgbench.bench.outcome import Outcome
from tdgbench.cells.record import Record
from tdgbench.experiments import matrix
from tdgbench.experiments.matrix import AxisValue, check_all_ran, groups_of, run_cells, table_of, values_of
from tests.helpers.configs import config

AXES = {
    "scene": values_of("scene", ["orbit", None]),
    "thermal_camera": groups_of("thermal_camera", {"ideal": {"estimate": []}}, variant="thermal_camera"),
    "skip": [AxisValue("none", {}), AxisValue("gray", {"skip.gray": False, "skip.unheard_of": True}, "gray off")],
    "seed": values_of("seed", [0, 1]),
}


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """The configurations and variants that were run; every cell with seed 1 fails."""
    found = []

    def run_cell(cfg, variant, progress):
        found.append((cfg, variant))
        status = "failed" if cfg.seed else "ok"
        record = Record("tdg", "made", cfg.scene or "only", "colmap", cfg.seed, "single", variant)
        record.seconds = {"train": 2.0}
        if status == "ok":
            folder = tmp_path / "single" / "cells" / str(len(found))
            folder.mkdir(parents=True)
            record.write(folder)
        return Outcome(status, record.title, "so")

    monkeypatch.setattr(matrix, "run_cell", run_cell)
    return found


def test_each_combination_is_a_cell_with_its_options(ran, tmp_path):
    cfg = config(f"results={tmp_path}")
    cells = run_cells(cfg, AXES)
    assert [tuple(cell.labels.values()) for cell in cells] == [
        (scene, "ideal", skip, seed) for scene in ("orbit", None) for skip in ("none", "gray") for seed in (0, 1)
    ]
    assert [(c.scene, c.seed, c.skip.gray, c.skip.get("unheard_of"), variant) for c, variant in ran[:4]] == [
        ("orbit", 0, True, None, "thermal_camera=ideal"), ("orbit", 1, True, None, "thermal_camera=ideal"),
        ("orbit", 0, False, True, "thermal_camera=ideal,gray off"),
        ("orbit", 1, False, True, "thermal_camera=ideal,gray off"),
    ]  # fmt: skip
    assert "unheard_of" not in cfg.skip and cfg.seed == 0


def test_finished_cells_are_rows_and_failed_ones_are_told(ran, tmp_path, capsys):
    cells = run_cells(config(f"results={tmp_path}"), AXES)
    table = table_of(cells, lambda record: {"seconds": record.seconds["train"]})
    assert list(table.columns) == ["scene", "thermal_camera", "skip", "seed", "seconds"] and len(table) == 4
    assert list(table["scene"]) == ["orbit", "orbit", "only", "only"] and set(table["seed"]) == {0}
    told = capsys.readouterr()
    assert told.out.count("failed:") == 4 and told.err.count("done") == 4
    check_all_ran([cell for cell in cells if cell.record is not None])
    with pytest.raises(SystemExit):
        check_all_ran(cells)
