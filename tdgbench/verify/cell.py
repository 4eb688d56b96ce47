"""Verify one cell: each check on its own, so that none hides what another one finds."""

from __future__ import annotations

from pathlib import Path

from tdgbench.bench.cameras import read_cameras
from tdgbench.bench.record import FILE
from tdgbench.bench.scores import read_views
from tdgbench.bench.stored import cell_files, file_problems
from tdgbench.verify import facts
from tdgbench.verify.findings import Findings
from tdgbench.verify.pictures import StoredPictures, picture_problems
from tdgbench.verify.scores import mask_problems, mean_problems, score_problems
from tdgbench.verify.stored_cell import read_cell, read_log


def verify_cell(folder: Path) -> list[str]:
    """Return the problems of one cell, in words; of a failed cell, only those of its record."""
    found = Findings()
    cell = found.read(FILE, read_cell, folder)
    if cell is None:
        return found.problems
    record = cell.record
    found.check(f"fields of {FILE}", cell.schema_problems)
    found.check("the key", facts.key_problems, record)
    if record.status == "failed":
        return found.problems
    found.check("its files", file_problems, folder, record.hashes)
    found.check("its settings", facts.setting_problems, record)
    cameras = found.read("cameras.json", read_cameras, folder)
    rows = found.read("views.csv", read_views, folder / "views.csv")
    log = found.read("log.csv", read_log, folder)
    if log is not None:
        found.check("log.csv", facts.log_problems, record, log)
    found.check("its models", facts.model_problems, folder, record)
    found.check("scores of training views", facts.train_score_problems, record)
    if rows is not None:
        found.check("means of views.csv", mean_problems, record, rows)
    if cameras is None:
        return found.problems
    found.check("the number of views", facts.view_problems, record, cameras)
    found.check("its pictures", picture_problems, set(cell_files(folder)), list(cameras["test"]))
    if rows is not None:
        found.check("rows of views.csv", facts.row_problems, rows, cameras["test"])
    pictures = StoredPictures(folder, record, cameras, found)
    pictures.check_renders()
    found.check("its masks", mask_problems, record, pictures)
    found.check("scores", score_problems, record, rows, pictures)
    return found.problems
