"""Verify one cell: each check on its own, so that none hides what another one finds."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.paths import CAMERAS_FILE, LOG_FILE, RECORD_FILE, VIEWS_FILE
from tdgbench.cells.read_files import read_text
from tdgbench.cells.record import Record
from tdgbench.verify import record_problems
from tdgbench.verify.pictures import check_renders, picture_problems
from tdgbench.verify.problems import Problems
from tdgbench.verify.scores import mask_problems, mean_problems, score_problems
from tdgbench.verify.truth import truth_problems

UNKNOWN = {"method": "", "dataset": "", "scene": "", "init": "", "seed": 0, "experiment": "", "variant": ""}


def read_cell(folder: Path) -> tuple[CellFolder, str]:
    """Read a cell and the text of its record; fields that it lacks have their defaults.

    Raises ValueError if the record is no JSON object.
    """
    text = read_text(folder / RECORD_FILE)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{RECORD_FILE} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError("it is not a JSON object")
    known = {field.name for field in fields(Record)}
    stated = {name: value for name, value in content.items() if name in known}
    return CellFolder(folder, Record(**{**UNKNOWN, **stated})), text


def verify_cell(folder: Path, weights: Path | None = None) -> list[str]:
    """Return the problems of one cell, in words; of a failed cell, only those of its record.

    weights: file of LPIPS's backbone, for records of a file of their own.
    """
    problems = Problems()
    stated = problems.read(RECORD_FILE, read_cell, folder)
    if stated is not None:
        check_cell(*stated, problems, weights)
    return problems.all


def check_cell(cell: CellFolder, text: str, problems: Problems, weights: Path | None = None) -> None:
    """Add the problems of `verify_cell`."""
    record = cell.record
    problems.check(f"fields of {RECORD_FILE}", record_problems.field_problems, text)
    problems.check("the key", record_problems.key_problems, record)
    if record.status == "failed":
        return
    problems.check("its files", cell.file_problems)
    problems.check("its settings", record_problems.setting_problems, record)
    cameras = problems.read(CAMERAS_FILE, lambda: cell.cameras)
    rows = problems.read(VIEWS_FILE, cell.read_views)
    log = problems.read(LOG_FILE, cell.read_log)
    if log is not None:
        problems.check(LOG_FILE, record_problems.log_problems, record, log)
    problems.check("its models", record_problems.model_problems, cell)
    problems.check("its parameters", record_problems.parameter_problems, cell)
    problems.check("scores of training views", record_problems.train_score_problems, record)
    if rows is not None:
        problems.check(f"means of {VIEWS_FILE}", mean_problems, record, rows)
    if cameras is None:
        return
    problems.check("the number of views", record_problems.view_problems, record, cameras)
    problems.check("its pictures", picture_problems, set(cell.files()), list(cell.test_cameras))
    if rows is not None:
        problems.check(f"rows of {VIEWS_FILE}", record_problems.row_problems, rows, cell.test_cameras)
    depths = check_renders(cell, problems)
    problems.check("its masks", mask_problems, cell)
    problems.check("scores", score_problems, cell, rows, depths, weights)
    problems.check("its ground truth", truth_problems, cell)
