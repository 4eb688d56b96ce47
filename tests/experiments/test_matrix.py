from dataclasses import replace

import pandas as pd
import pytest

from tdgbench.bench.options import OptionError
from tdgbench.bench.progress import Outcome
from tdgbench.cells.record import Record
from tdgbench.experiments import matrix
from tdgbench.experiments.matrix import AxisValue, Matrix, groups_of, table_of, values_of
from tests.helpers.configs import config

AXES = {
    "scene": values_of("scene", ["orbit", None]),
    "thermal_camera": groups_of("thermal_camera", {"ideal": {"estimate": []}}, variant="thermal_camera"),
    "skip": [AxisValue("none", {}), AxisValue("gray", {"skip.gray": False, "skip.unheard_of": True}, "gray off")],
    "seed": values_of("seed", [0, 1]),
}


class Example(Matrix):
    """The combinations of AXES, but for scene `orbit` with seed 1."""

    def axes(self, cfg):
        return AXES

    def is_cell(self, labels):
        return (labels["scene"], labels["seed"]) != ("orbit", 1)

    def tables(self, cfg, cells):
        rows = table_of(cells, lambda record: {"seconds": record.seconds["train"]})
        return {} if rows.empty else {"sums": rows.drop(columns="skip"), "cells": rows}

    def show(self, table):
        print("shown", *table.columns)


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """The configurations and variants that were run; every cell with seed 1 fails."""
    found = []

    def run_cell(cfg, variant, progress):
        found.append((cfg, variant))
        status = "failed" if cfg.seed else "ok"
        record = Record("tdg", "made", cfg.scene or "only", "colmap", cfg.seed, "single", variant)
        record.seconds, record.channels = {"train": 2.0}, 3 if cfg.scene else 1
        if status == "ok":
            folder = tmp_path / "single" / "cells" / str(len(found))
            folder.mkdir(parents=True)
            record.write(folder)
        return Outcome(status, record.title, "so")

    monkeypatch.setattr(matrix, "run_cell", run_cell)
    return found


def test_each_combination_is_a_cell_with_its_options(ran, tmp_path):
    cfg = config(f"results={tmp_path}")
    cells = Example().run_cells(cfg)
    assert [tuple(cell.labels.values()) for cell in cells] == [
        ("orbit", "ideal", "none", 0), ("orbit", "ideal", "gray", 0),
        *((None, "ideal", skip, seed) for skip in ("none", "gray") for seed in (0, 1)),
    ]  # fmt: skip
    assert [(c.scene, c.seed, c.skip.gray, c.skip.get("unheard_of"), variant) for c, variant in ran[:3]] == [
        ("orbit", 0, True, None, "thermal_camera=ideal"), ("orbit", 0, False, True, "thermal_camera=ideal,gray off"),
        (None, 0, True, None, "thermal_camera=ideal"),
    ]  # fmt: skip
    assert "unheard_of" not in cfg.skip and cfg.seed == 0


def test_two_cells_in_one_place_are_refused_before_any_runs(ran, tmp_path, monkeypatch):
    axes = {**AXES, "skip": [AxisValue("on", {"skip.gray": True}), AxisValue("off", {"skip.gray": False})]}
    monkeypatch.setattr(Example, "axes", lambda self, cfg: axes)
    with pytest.raises(OptionError, match="orbit, ideal, on, 0 and orbit, ideal, off, 0 would be one cell"):
        Example().run_cells(config(f"results={tmp_path}"))
    assert not ran


def test_cells_of_other_processes_count_once_they_have_ended(ran, tmp_path, monkeypatch, capsys):
    here = matrix.run_cell

    def run_cell(cfg, variant, progress):
        outcome = here(cfg, variant, progress)
        if outcome.status == "ok" and cfg.scene is None:
            return replace(outcome, status="elsewhere")
        return Outcome("elsewhere", "not yet", "") if outcome.status == "ok" else outcome

    monkeypatch.setattr(matrix, "run_cell", run_cell)
    cells = Example().run_cells(config(f"results={tmp_path}"))
    assert [cell.record is not None for cell in cells] == [False, False, True, False, True, False]
    assert "2 cells run in other processes and are in no table" in capsys.readouterr().out


def test_finished_cells_are_rows_and_failed_ones_are_told(ran, tmp_path, capsys):
    with pytest.raises(SystemExit):
        Example().run(config(f"results={tmp_path}", "dataset=synthetic"))
    table = pd.read_csv(tmp_path / "single" / "cells.csv", keep_default_na=False)
    assert list(table.columns) == ["scene", "thermal_camera", "skip", "seed", "seconds", "image_values"]
    assert list(table["scene"]) == ["orbit", "orbit", "only", "only"] and set(table["seed"]) == {0}
    assert list(table["image_values"]) == ["palette, not temperature"] * 2 + [""] * 2
    told = capsys.readouterr()
    assert "shown scene thermal_camera seed seconds image_values" in told.out and "sums.csv, " in told.out
    assert told.out.count("failed:") == 2 and told.err.count("done") == 4
