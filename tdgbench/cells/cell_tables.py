"""`views.csv`: the scores of each test view; `log.csv`: lines of the training."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from tdgbench.cells.paths import LOG_FILE, VIEWS_FILE
from tdgbench.cells.read_files import read_table
from tdgbench.cells.record import LARGEST_SCORE
from tdgbench.scoring import METRICS, Scores
from tdgbench.text import csv_text, from_csv, shortened
from tdgbench.training.loop import TrainingLog

LOG_COLUMNS = ("iteration", "seconds", "loss", "smoothed_psnr", "gaussians")  # then one for each term of the loss
NOT_APPLICABLE = "n/a"


def write_views(folder: Path, scores: dict[str, Scores]) -> None:
    """Write scores by view and metric: one row per view; n/a where a metric has no value."""
    metrics = list(next(iter(scores.values()), METRICS))
    with (folder / VIEWS_FILE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["view", *metrics])
        for name, values in scores.items():
            writer.writerow([csv_text(name), *(NOT_APPLICABLE if values[m] is None else values[m] for m in metrics)])


def read_views(folder: Path) -> dict[str, Scores]:
    """Return scores by view and metric, None for n/a.

    Raises ValueError for a file of any other form (a repeated view or column, a row that is too short, no number), and
    FileNotFoundError where there is none.
    """
    rows = read_table(folder / VIEWS_FILE)
    if not rows or not rows[0] or rows[0][0] != "view" or len(set(rows[0])) != len(rows[0]):
        raise ValueError("its first line is not `view` and the names of metrics")
    found: dict[str, Scores] = {}
    for row in rows[1:]:
        name = from_csv(row[0])
        if name in found:
            raise ValueError(f"it has two rows of {name}")
        places = zip(rows[0][1:], row[1:], strict=True)
        found[name] = {m: None if text == NOT_APPLICABLE else _finite(text, f"{m} of {name}") for m, text in places}
    return found


def write_log(folder: Path, log: TrainingLog) -> None:
    """Write one row per logged iteration; one column per loss term."""
    terms = sorted({term for line in log.lines for term in line.terms})
    with (folder / LOG_FILE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*LOG_COLUMNS, *(f"loss_{term}" for term in terms)])
        for line in log.lines:
            values = [line.terms.get(term, "") for term in terms]
            writer.writerow([line.iteration, round(line.seconds, 3), line.loss, line.psnr, line.gaussians, *values])


def read_log(folder: Path) -> list[dict[str, float]]:
    """Return the rows: LOG_COLUMNS, and terms of the loss that the row has. Raises as `read_views`."""
    rows = read_table(folder / LOG_FILE)
    if not rows or len(set(rows[0])) != len(rows[0]) or not set(LOG_COLUMNS) <= set(rows[0]):
        raise ValueError(f"its first line does not name {', '.join(LOG_COLUMNS)}, each once")
    named = [zip(rows[0], row, strict=True) for row in rows[1:]]
    return [{name: _finite(text, name) for name, text in row if text or name in LOG_COLUMNS} for row in named]


def _finite(text: str, what: str) -> float:
    """Return a number from a CSV field. Raises ValueError, naming it by `what`, if it is none or out of range."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST_SCORE:  # NaN included
        raise ValueError(f"{what} is {shortened(text, 60)!r}, which is no finite number up to {LARGEST_SCORE:g}")
    return value
