"""Cells of masked scenes are verified whole, and a mask that was changed is found."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tdgbench.cells.folder import CellFolder, hashes_below
from tdgbench.cells.record import read_record
from tdgbench.verify import verify, verify_cell


@pytest.fixture
def cell(masked_results, tmp_path) -> Path:
    """A copy of a cell of a masked gray scene."""
    return Path(shutil.copytree(masked_results / "cells/msmg/synthetic/turntable/colmap/seed0", tmp_path / "cell"))


def pictures(cell: Path, sub: str) -> dict[str, np.ndarray]:
    return {path.stem: np.asarray(Image.open(path)) for path in sorted((cell / sub).glob("*.png"))}


def rehash(cell: Path, **changes) -> None:
    """Let the record fit what was changed."""
    content = json.loads((cell / "record.json").read_text())
    (cell / "record.json").write_text(json.dumps({**content, **changes, "hashes": hashes_below(cell)}))


def test_sound_cells(masked_results):
    """But for their ground truth, which is masked, and not that of the built-in scenes that they name."""
    verified = verify(masked_results)
    assert verified[:2] == (2, 2) and len(verified.problems) == 2
    assert all("test views is not that of synthetic/" in problem for problem in verified.problems)
    assert all(verify_cell(path.parent) == [] for path in masked_results.rglob("record.json"))


def test_the_record_counts_masked_pixels(cell):
    record, found = read_record(cell), pictures(cell, "masks")
    assert len(found) == len(pictures(cell, "renders")) - 1  # one test view has no mask
    masked = sum(int((mask == 0).sum()) for mask in found.values())
    assert record.masked["test"] == masked / (36 * 48 * record.views["test"]) > 0.1
    assert 0.1 < record.masked["train"] < 0.6


def test_scores_are_those_of_valid_pixels(cell):
    """PSNR and °C of the written pictures, by hand."""
    with (cell / "views.csv").open(newline="") as file:
        rows = {row["view"]: row for row in csv.DictReader(file)}
    record, renders, targets = read_record(cell), pictures(cell, "renders"), pictures(cell, "targets")
    masks = {name: CellFolder(cell, read_record(cell)).mask(name) for name in pictures(cell, "masks")}
    assert masks and set(masks) < set(rows)
    low, high = record.temperature_range
    for name, mask in masks.items():
        assert not targets[name][~mask].any()
        error = (renders[name].astype(float) - targets[name])[mask] / 255
        assert float(rows[name]["psnr"]) == pytest.approx(-10 * np.log10((error**2).mean()), abs=1e-6)
        assert float(rows[name]["mae_degC"]) == pytest.approx(np.abs(error).mean() * (high - low), abs=1e-6)


def test_without_a_valid_pixel_a_score_is_na_with_the_reason(masked_results):
    cell = masked_results / "cells/3dgs/synthetic/facade/colmap/seed0"
    record = read_record(cell)
    with (cell / "views.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    for name in ("psnr", "ssim", "channel_psnr", "mae_degC"):
        assert first[name] == "n/a" and float(second[name]) > 0 and record.scores[name] is None
        assert record.missing[name] == f"no pixel of view {first['view']} has a thermal value: its mask leaves none"
    assert record.train_scores["psnr"] > 5


def test_another_mask_is_found(cell):
    path = next((cell / "masks").glob("*.png"))
    values = np.asarray(Image.open(path)).copy()
    values[5:20] = 0
    Image.fromarray(values).save(path)
    problems = "\n".join(verify_cell(cell))
    assert f"masks/{path.name} has changed" in problems
    rehash(cell)
    problems = "\n".join(verify_cell(cell))
    assert "masked.test is" in problems and f"psnr of {path.stem} is" in problems


def test_a_missing_mask_is_found(cell):
    path = next((cell / "masks").glob("*.png"))
    path.unlink()
    assert f"masks/{path.name} is missing" in "\n".join(verify_cell(cell))
    rehash(cell)
    assert "masked.test is" in "\n".join(verify_cell(cell))


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (lambda path: path.write_bytes(b"\x89PNG"), "png cannot be read: "),
        (lambda path: Image.new("RGB", (48, 36)).save(path), "png is no mask: its values must be 0 and 255"),
        (lambda path: Image.new("L", (48, 36), 7).save(path), "png is no mask: its values must be 0 and 255"),
        (lambda path: Image.new("L", (36, 48)).save(path), "it is 36×48 px, its camera 48×36 px"),
        (lambda path: shutil.copy(path, path.with_name("x.png")), "masks/x.png is of no test view"),
    ],
)
def test_what_is_no_mask_is_a_problem(cell, spoil, problem):
    spoil(next((cell / "masks").glob("*.png")))
    rehash(cell)
    found = verify_cell(cell)
    assert problem in "\n".join(found) and all(len(one) < 400 and "Traceback" not in one for one in found)
