"""Score the stored files of a finished cell again, and write the outcome as a cell beside them.

A value is taken over if nothing that it depends on differs: the number of the protocol, the options of `metrics` that
its metric names, the renders (by their recorded hashes). All others are computed: metrics of pictures from the stored
8-bit renders, which give the same value as in training; others from float renders of the stored model. What no file of
a cell has (true depth, training views) is n/a.
"""

from __future__ import annotations

import os
import shutil
import time
from collections import ChainMap
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from tdgbench.cells.cell_tables import write_views
from tdgbench.cells.folder import CellFolder, hashes_below, is_same_training
from tdgbench.cells.key import cell_key, flat
from tdgbench.cells.known_classes import UnknownMethodError
from tdgbench.cells.paths import VIEWS_FILE
from tdgbench.cells.protocol import VERSION, protocol_of
from tdgbench.cells.record import Record, readable_record
from tdgbench.files import whole_folder
from tdgbench.scenes import Scene
from tdgbench.scoring import METRICS, Scorer, Scores, mean_scores
from tdgbench.scoring.metric import ImageMetric, Metric

NO_MODEL = "the cell has no model to render again"
NO_RENDERS = "renders of training views are not stored"


class EarlierScores(NamedTuple):
    """A cell that was scored, its rows of views.csv, and the metrics whose values the new protocol shares."""

    cell: CellFolder
    rows: dict[str, Scores]
    metrics: list[str]


def score_cell(cell: CellFolder, target: Path, scorer: Scorer, metrics: dict[str, Any]) -> Scores:
    """Score a finished cell again; return the scores that were asked for anew. The caller must hold `target`'s lock.

    target: the cell's folder in the new experiment. metrics: options, as records keep them. Raises ValueError for files
    that are not those of the record, and if `target` holds another training.
    """
    record = cell.record
    problem = next(cell.file_problems(), None)
    if problem is not None:
        raise ValueError(f"{problem}; see tdgbench verify")
    config = {**record.config, "metrics": metrics}
    new = replace(record, config=config, convention=metrics["convention"], protocol=protocol_of(config))
    new.key = cell_key(new)
    earlier = _earlier_scores(cell, target, new)
    todo = [metric for name, metric in scorer.metrics.items() if name not in earlier.metrics]
    start = time.perf_counter()
    rows = _rows(cell, scorer, earlier, todo)
    new.scores, new.train_scores = mean_scores(rows), dict(record.train_scores)
    there = earlier.cell.record
    if earlier.cell is not cell and (new.scores, config) == (there.scores, there.config):
        return {}
    kept = {name: why for name, why in there.missing.items() if name in earlier.metrics or name not in scorer.metrics}
    new.missing = {**kept, **{name: why for name, why in scorer.missing.items() if new.scores[name] is None}}
    for name, metric in scorer.train_metrics.items():
        if name not in record.train_scores or not _is_same(metric, record, new):
            new.train_scores[name], new.missing[f"train_{name}"] = None, NO_RENDERS
    new.seconds = {**record.seconds, "score": round(time.perf_counter() - start, 3)}
    if new.protocol != record.protocol:
        new.notes = [*record.notes, f"scored again: protocol {new.protocol}, trained with {record.protocol or 'none'}"]
    _write(cell, target, new, rows)
    return {metric.name: new.scores[metric.name] for metric in todo}


def _earlier_scores(cell: CellFolder, target: Path, new: Record) -> EarlierScores:
    """Return the values that can be taken over: those of an earlier scoring in `target`, else those of the cell.

    Those of the user's metrics cannot: their code may have changed.
    """
    there, source = readable_record(target), cell
    if there is not None and there.failure is None:
        if not is_same_training(cell.record, there):
            raise ValueError(f"{target} holds another training; name a new folder, or delete it")
        scored = CellFolder(target, there)
        if there.protocol == new.protocol and not any(scored.file_problems()):
            source = scored
    record, rows = source.record, source.read_views()
    shared = [
        name
        for name, metric in METRICS.items()
        if name in record.scores
        and all(name in row for row in rows.values())
        and _is_same(metric, record, new)
        and not (record.scores[name] is None and metric.of_network)  # weights may be there by now
    ]
    return EarlierScores(source, rows, shared)


def _is_same(metric: Metric, old: Record, new: Record) -> bool:
    """Return whether a metric has the same value by the settings of both records."""
    before, after = (flat(record.config.get("metrics") or {}) for record in (old, new))
    is_current = old.protocol_number == str(VERSION)
    return is_current and all(before.get(name) == after.get(name) for name in metric.options)


def _rows(cell: CellFolder, scorer: Scorer, earlier: EarlierScores, todo: list[Metric]) -> dict[str, Scores]:
    """Return the scores of each test view, in the order of the scorer's metrics."""
    views, scene, scorer.missing = list(cell.test_cameras), cell.scene(), {}
    by_pictures = [metric for metric in todo if isinstance(metric, ImageMetric)]
    by_model = [metric for metric in todo if not isinstance(metric, ImageMetric)]
    found = [{view: {m: earlier.rows[view][m] for m in earlier.metrics} for view in views}]
    if by_pictures:
        found.append(scorer.score(scene, {view: cell.rendered(view) for view in views}, by_pictures))
    if by_model:
        found.append(_scores_by_model(cell, scene, scorer, by_model))
    rows = {view: ChainMap(*(scores[view] for scores in found)) for view in views}
    return {view: {metric: row[metric] for metric in scorer.metrics} for view, row in rows.items()}


def _scores_by_model(cell: CellFolder, scene: Scene, scorer: Scorer, metrics: list[Metric]) -> dict[str, Scores]:
    """Return the scores of each test view that renders of the model give; None where it cannot be rendered."""
    why_not = NO_MODEL
    if cell.has_model:
        try:
            return scorer.score(scene, cell.rendered_again(), metrics)
        except UnknownMethodError as error:
            why_not = str(error)
    scorer.missing |= {metric.name: why_not for metric in metrics}
    return {view: dict.fromkeys(metric.name for metric in metrics) for view in cell.test_cameras}


def _write(cell: CellFolder, target: Path, record: Record, rows: dict[str, Scores]) -> None:
    """Write a cell whose files are those of `cell`, but for its scores; links where the file system has them."""
    with whole_folder(target) as part:
        for name, path in cell.files().items():
            if name != VIEWS_FILE:
                (part / name).parent.mkdir(parents=True, exist_ok=True)
                try:
                    os.link(path, part / name)
                except OSError:
                    shutil.copyfile(path, part / name)
        write_views(part, rows)
        record.hashes = hashes_below(part)
        record.write(part)
