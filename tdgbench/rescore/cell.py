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

from tdgbench.bench.scores import Row, read_views, write_views
from tdgbench.cells.cameras import read_cameras
from tdgbench.cells.key import cell_key, flat
from tdgbench.cells.known_classes import UnknownMethodError
from tdgbench.cells.protocol import VERSION, protocol_of
from tdgbench.cells.record import Record
from tdgbench.cells.stored import cell_files, file_problems, hashes, readable_record
from tdgbench.cells.stored_views import StoredViews
from tdgbench.files import whole_folder
from tdgbench.scoring import METRICS, TRAIN_METRICS, Scorer, mean_scores
from tdgbench.scoring.metric import ImageMetric, Metric

VIEWS = "views.csv"
NO_MODEL = "the cell has no model to render again"
NO_RENDERS = "renders of training views are not stored"


class Known(NamedTuple):
    """A record that was scored, its rows of views.csv, and the metrics whose values the new protocol shares."""

    record: Record
    rows: dict[str, Row]
    metrics: list[str]
    is_there: bool  # it lies in the new experiment already


def score_cell(folder: Path, record: Record, target: Path, scorer: Scorer, metrics: dict[str, Any]) -> list[str]:
    """Score a finished cell again; return the metrics that were computed. The caller must hold the lock on `target`.

    target: the cell's folder in the new experiment. metrics: options, as records keep them. Raises ValueError for files
    that are not those of the record, and if `target` holds another training.
    """
    problem = next(file_problems(folder, record.hashes), None)
    if problem is not None:
        raise ValueError(f"{problem}; see tdgbench verify")
    config = {**record.config, "metrics": metrics}
    new = replace(record, config=config, convention=metrics["convention"], protocol=protocol_of(config))
    new.key = cell_key(new)
    known = _known(folder, record, target, new)
    todo = [metric for name, metric in METRICS.items() if name not in known.metrics]
    start = time.perf_counter()
    rows = _rows(StoredViews(folder, record, read_cameras(folder)), scorer, known, todo)
    new.scores, new.train_scores = mean_scores(rows), dict(record.train_scores)
    if known.is_there and (new.scores, config) == (known.record.scores, known.record.config):
        return []
    kept = {name: why for name, why in known.record.missing.items() if name in known.metrics or name not in METRICS}
    new.missing = {**kept, **{name: why for name, why in scorer.missing.items() if new.scores[name] is None}}
    for name, metric in TRAIN_METRICS.items():
        if not _is_same(metric, record, new):
            new.train_scores[name], new.missing[f"train_{name}"] = None, NO_RENDERS
    new.seconds = {**record.seconds, "score": round(time.perf_counter() - start, 3)}
    if new.protocol != record.protocol:
        new.notes = [*record.notes, f"scored again: protocol {new.protocol}, trained with {record.protocol or 'none'}"]
    _write(folder, target, new, rows)
    return [metric.name for metric in todo]


def _known(folder: Path, record: Record, target: Path, new: Record) -> Known:
    """Return the values that can be taken over: those of an earlier scoring in `target`, else those of the cell."""
    there, source = readable_record(target), folder
    if there is not None and there.failure is None:
        if {**there.hashes, VIEWS: ""} != {**record.hashes, VIEWS: ""}:
            raise ValueError(f"{target} holds another training; name a new folder, or delete it")
        if there.protocol == new.protocol and not any(file_problems(target, there.hashes)):
            record, source = there, target
    rows = read_views(source / VIEWS)
    shared = [
        name
        for name, metric in METRICS.items()
        if name in record.scores
        and all(name in row for row in rows.values())
        and _is_same(metric, record, new)
        and not (record.scores[name] is None and metric.of_network)  # weights may be there by now
    ]
    return Known(record, rows, shared, source == target)


def _is_same(metric: Metric, old: Record, new: Record) -> bool:
    """Return whether a metric has the same value by the settings of both records."""
    before, after = (flat(record.config.get("metrics") or {}) for record in (old, new))
    number = old.protocol.partition("-")[0]
    return number == str(VERSION) and all(before.get(name) == after.get(name) for name in metric.options)


def _rows(stored: StoredViews, scorer: Scorer, known: Known, todo: list[Metric]) -> dict[str, Row]:
    """Return the scores of each test view, in the order of METRICS."""
    scene, scorer.missing = stored.scene(), {}
    by_pictures = [metric for metric in todo if isinstance(metric, ImageMetric)]
    by_model = [metric for metric in todo if not isinstance(metric, ImageMetric)]
    found = [{name: {m: known.rows[name][m] for m in known.metrics} for name in stored.cameras}]
    if by_pictures:
        found.append(scorer.score(scene, {name: stored.rendered(name) for name in stored.cameras}, by_pictures))
    why_not = ""
    if by_model and stored.record.gaussians:
        try:
            found.append(scorer.score(scene, stored.rendered_again(), by_model))
        except UnknownMethodError as error:
            why_not = str(error)
    elif by_model:
        why_not = NO_MODEL
    if why_not:
        scorer.missing |= {metric.name: why_not for metric in by_model}
        found.append({name: dict.fromkeys(metric.name for metric in by_model) for name in stored.cameras})
    rows = {name: ChainMap(*(scores[name] for scores in found)) for name in stored.cameras}
    return {name: {metric: row[metric] for metric in METRICS} for name, row in rows.items()}


def _write(folder: Path, target: Path, record: Record, rows: dict[str, Row]) -> None:
    """Write a cell whose files are those of `folder`, but for its scores; links where the file system has them."""
    with whole_folder(target) as part:
        for name, path in cell_files(folder).items():
            if name != VIEWS:
                (part / name).parent.mkdir(parents=True, exist_ok=True)
                try:
                    os.link(path, part / name)
                except OSError:
                    shutil.copyfile(path, part / name)
        write_views(part / VIEWS, rows)
        record.hashes = hashes(part)
        record.write(part)
