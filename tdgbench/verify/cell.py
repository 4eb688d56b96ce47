"""Verify one cell: each check on its own, so that none hides what another one finds."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

from tdgbench.bench.scores import finite_field, read_views
from tdgbench.cells.cameras import read_cameras
from tdgbench.cells.read_files import read_table, read_text
from tdgbench.cells.record import FILE, Record
from tdgbench.cells.stored import cell_files, file_problems
from tdgbench.verify import facts
from tdgbench.verify.pictures import StoredPictures, picture_problems
from tdgbench.verify.problems import Problems
from tdgbench.verify.scores import mask_problems, mean_problems, score_problems
from tdgbench.verify.truth import truth_problems

UNKNOWN = {"method": "", "dataset": "", "scene": "", "init": "", "seed": 0, "experiment": "", "variant": ""}


class StoredCell(NamedTuple):
    """The text of a cell's record, and the record."""

    text: str
    record: Record


def read_cell(folder: Path) -> StoredCell:
    """Read a cell's record; fields that it lacks have their defaults. Raises ValueError if it is no JSON object."""
    text = read_text(folder / FILE)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{FILE} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError("it is not a JSON object")
    known = {f.name for f in fields(Record)}
    return StoredCell(text, Record(**{**UNKNOWN, **{k: v for k, v in content.items() if k in known}}))


def read_log(folder: Path) -> list[dict[str, float]]:
    """Read the rows of log.csv: iteration, seconds, loss, smoothed_psnr, gaussians. Raises ValueError for others."""
    names = ["iteration", "seconds", "loss", "smoothed_psnr", "gaussians"]
    rows = read_table(folder / "log.csv")
    if not rows or rows[0][: len(names)] != names:
        raise ValueError(f"its first line does not begin with {','.join(names)}")
    return [{name: finite_field(text, name) for name, text in zip(names, row, strict=False)} for row in rows[1:]]


def verify_cell(folder: Path, weights: Path | None = None) -> list[str]:
    """Return the problems of one cell, in words; of a failed cell, only those of its record.

    weights: file of LPIPS's backbone, for records of a file of their own.
    """
    problems = Problems()
    cell = problems.read(FILE, read_cell, folder)
    if cell is None:
        return problems.all
    record = cell.record
    problems.check(f"fields of {FILE}", facts.field_problems, cell.text)
    problems.check("the key", facts.key_problems, record)
    if record.status == "failed":
        return problems.all
    problems.check("its files", file_problems, folder, record.hashes)
    problems.check("its settings", facts.setting_problems, record)
    cameras = problems.read("cameras.json", read_cameras, folder)
    rows = problems.read("views.csv", read_views, folder / "views.csv")
    log = problems.read("log.csv", read_log, folder)
    if log is not None:
        problems.check("log.csv", facts.log_problems, record, log)
    problems.check("its models", facts.model_problems, folder, record)
    problems.check("scores of training views", facts.train_score_problems, record)
    if rows is not None:
        problems.check("means of views.csv", mean_problems, record, rows)
    if cameras is None:
        return problems.all
    problems.check("the number of views", facts.view_problems, record, cameras)
    problems.check("its pictures", picture_problems, set(cell_files(folder)), list(cameras["test"]))
    if rows is not None:
        problems.check("rows of views.csv", facts.row_problems, rows, cameras["test"])
    pictures = StoredPictures(folder, record, cameras, problems)
    pictures.check_renders()
    problems.check("its masks", mask_problems, record, pictures)
    problems.check("scores", score_problems, record, rows, pictures, weights)
    problems.check("its ground truth", truth_problems, folder, record)
    return problems.all
