"""Cells are shown as their records say; whatever cannot be shown is one clear error."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from tdgbench.cells.folder import hashes_below
from tdgbench.cells.read_files import read_picture
from tdgbench.cells.record import Record, read_record
from tdgbench.view.cells import open_cell, open_cells, short_names


def test_a_cell_has_models_cameras_and_pictures(tdg_folder, msmg_folder):
    cells = open_cells([tdg_folder, msmg_folder, tdg_folder])
    assert list(cells) == ["tdg", "msmg"]
    tdg, msmg = cells.values()
    assert set(tdg.models) == {"thermal"} and set(msmg.models) == {"thermal", "rgb"}
    assert tdg.degC == tuple(tdg.record.temperature_range) and len(tdg.train) == 8 and len(tdg.test) == 2
    view = next(iter(msmg.test))
    pictures = msmg.pictures(view)
    assert set(pictures) == {"thermal", "rgb"} and set(tdg.pictures(view)) == {"thermal"}
    assert np.array_equal(pictures["rgb"], read_picture(msmg_folder / "targets_rgb" / f"{view}.png"))
    assert tdg.pictures(next(iter(tdg.train))) == {}


def test_pseudo_colour_has_no_temperatures(colour_folder):
    assert open_cell(colour_folder).degC is None


def test_without_ground_truth_the_render_is_the_picture(msmg_folder, tmp_path):
    folder = rehashed(copied(msmg_folder, tmp_path), lambda cell: shutil.rmtree(cell / "targets"))
    cell = open_cell(folder)
    view = next(iter(cell.test))
    assert np.array_equal(cell.pictures(view)["thermal"], read_picture(folder / "renders" / f"{view}.png"))


def copied(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "cell"))


def rehashed(folder: Path, change) -> Path:
    """Change a cell, and make the record's hashes fit."""
    change(folder)
    record = read_record(folder)
    record.hashes = hashes_below(folder)
    record.write(folder)
    return folder


DAMAGES = {
    "no folder": (shutil.rmtree, "is not there"),
    "no record": (lambda cell: (cell / "record.json").unlink(), "holds no record"),
    "broken record": (lambda cell: (cell / "record.json").write_text("{"), "is not a record"),
    "model changed": (lambda cell: (cell / "model.ply").write_bytes(b"ply"), "is damaged: model.ply has changed"),
    "foreign file": (lambda cell: (cell / "x").write_text(""), "is damaged: x is not in the record"),
    "model FIFO": (
        lambda cell: [(cell / "model.ply").unlink(), os.mkfifo(cell / "model.ply")], "is damaged: model.ply cannot"),
    "no model": (lambda cell: rehashed(cell, lambda c: (c / "model.ply").unlink()), "it lacks model.ply"),
    "model of another kind": (
        lambda cell: rehashed(cell, lambda c: (c / "model.ply").write_bytes(b"ply")), "cannot be shown: "),
    "no cameras": (
        lambda cell: rehashed(cell, lambda c: (c / "cameras.json").write_text("[]")), "cannot be shown: "),
}  # fmt: skip


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_cell_is_refused(tdg_folder, tmp_path, damage, message):
    folder = copied(tdg_folder, tmp_path)
    damage(folder)
    with pytest.raises(ValueError) as error:
        open_cell(folder)
    assert message in str(error.value) and str(folder) in str(error.value) and "\n" not in str(error.value)


def test_a_failed_cell_has_no_model(small_results):
    with pytest.raises(ValueError, match="has no model: it failed in "):
        open_cell(small_results / "cells" / "tdg" / "synthetic" / "night" / "colmap" / "seed0")


def test_an_experiment_is_no_cell_and_the_message_names_one(small_results):
    with pytest.raises(ValueError, match=r"holds no record; name the folder of a cell, such as \S*/cells/\S*/seed0"):
        open_cell(small_results)


def test_cells_of_two_scenes_are_refused(tdg_folder, colour_folder):
    with pytest.raises(ValueError, match=r"is of scene orbit, .* of turntable; cells .* must be of one scene"):
        open_cells([tdg_folder, colour_folder])


def test_names_tell_cells_apart():
    def record(method="tdg", seed=0, init="colmap", variant="") -> Record:
        return Record(method, "paper", "Truck", init, seed, "table1", variant)

    assert short_names([record(), record("msmg")]) == ["tdg", "msmg"]
    assert short_names([record(), record(seed=1)]) == ["tdg, seed 0", "tdg, seed 1"]
    assert short_names([record(), record(variant="a=1")]) == ["tdg", "tdg, a=1"]
    assert short_names([record(), record(), record()]) == ["tdg", "tdg (2)", "tdg (3)"]
