"""What a record says about itself, its models, its log and its views."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tdgbench.bench.scores import Row
from tdgbench.cells.cameras import Cameras
from tdgbench.cells.key import cell_key
from tdgbench.cells.metric_settings import metric_settings
from tdgbench.cells.paths import cell_folder_of, files_of
from tdgbench.cells.protocol import protocol_of
from tdgbench.cells.record import FILE, Record, schema_problems
from tdgbench.scenes.modalities import THERMAL
from tdgbench.scoring import TRAIN_METRICS
from tdgbench.splats.ply import count_rows

TIME_TOLERANCE = 0.002  # s; times are rounded to milliseconds


def field_problems(text: str) -> Iterator[str]:
    """Yield what does not fit the schema in the text of a record, and numbers that are none in JSON."""
    yield from (f"{FILE}: {problem}" for problem in schema_problems(text))
    constants: list[str] = []
    json.loads(text, parse_constant=constants.append)
    yield from (f"{FILE} holds {name}, which is no number in JSON" for name in dict.fromkeys(constants))


def place_problems(folder: Path, record: Record) -> Iterator[str]:
    """Yield the folder that the record belongs to, if it lies in another one."""
    place = cell_folder_of(Path(), record)
    if folder.absolute().parts[-len(place.parts) :] != place.parts:
        yield f"{FILE} is of another cell: its folder is {place.as_posix()}; move it there, or run the cell again"


def key_problems(record: Record) -> Iterator[str]:
    """Yield a key that is not that of the recorded configuration, data, scene and code. A failed cell may have none."""
    if record.status == "failed" and not record.key:
        return
    expected = cell_key(record)
    if record.key != expected:
        yield f"{FILE}: key is {record.key!r}, its configuration, data and code give {expected!r}"
    number = record.protocol.partition("-")[0]
    if record.protocol and record.protocol != protocol_of(record.config, number):
        yield f"{FILE}: protocol is {record.protocol!r}, its settings give {protocol_of(record.config, number)!r}"


def setting_problems(record: Record) -> Iterator[str]:
    """Yield fields that differ from the configuration, and settings of scores that are unknown."""
    stated = {"method.name": record.method, "init.name": record.init, "seed": record.seed}
    stated["metrics.convention"] = record.convention
    for name, value in stated.items():
        if record.setting(name) != value:
            yield f"{FILE}: {name} is {value!r}, its configuration has {record.setting(name)!r}"
    metric_settings(record.setting("metrics"))


def log_problems(record: Record, log: list[dict[str, float]]) -> Iterator[str]:
    """Check iterations, Gaussians and training time against the log."""
    if not log or record.made_elsewhere is not None:
        if log or record.made_elsewhere is None:
            yield f"log.csv has {'rows, and nothing was trained' if log else 'no row'}"
        return
    iterations, last = [row["iteration"] for row in log], log[-1]
    if iterations != sorted(set(iterations)):
        yield "log.csv: its iterations do not increase"
    if last["iteration"] != record.iterations:
        yield f"{FILE}: iterations is {record.iterations}, log.csv ends at {last['iteration']:g}"
    planned = record.setting("budget.iterations")
    if isinstance(planned, int) and record.iterations > planned:
        yield f"{FILE}: iterations is {record.iterations}, its configuration has {planned}"
    if last["gaussians"] != sum(record.gaussians.values()):
        yield f"{FILE}: gaussians is {record.gaussians}, log.csv ends with {last['gaussians']:g}"
    if last["seconds"] > record.seconds["train"] + TIME_TOLERANCE:
        yield f"{FILE}: seconds.train is {record.seconds['train']}, log.csv ends at {last['seconds']}"


def model_problems(folder: Path, record: Record) -> Iterator[str]:
    """Check models against the recorded number of Gaussians."""
    needed = {THERMAL: None} if record.made_elsewhere is None else {}
    expected = {files_of(name).model: count for name, count in {**needed, **record.gaussians}.items()}
    for name in sorted({*expected, *(path.name for path in folder.glob("model*.ply"))}):
        count = expected.get(name)
        if count is None:
            yield f"{FILE}: gaussians has no count for {name}"
            continue
        try:
            rows = count_rows(folder / name, folder)
            if rows != count:
                yield f"{FILE}: gaussians has {count} for {name}, which holds {rows}"
        except (OSError, ValueError) as error:
            yield f"{name} cannot be read: {error}"


def train_score_problems(record: Record) -> Iterator[str]:
    """Yield scores of training views that are missing. (Their pictures are not stored; they are not computed again.)"""
    for metric in TRAIN_METRICS:
        if metric not in record.train_scores:
            yield f"{FILE}: train_scores lacks {metric}"
        elif record.train_scores[metric] is None and not (record.missing.keys() & {metric, f"train_{metric}"}):
            yield f"{FILE}: train_scores.{metric} is n/a without a reason"


def view_problems(record: Record, cameras: Cameras) -> Iterator[str]:
    """Check numbers of views against the cameras."""
    for part, views in cameras.items():
        if record.views.get(part) != len(views):
            yield f"{FILE}: views.{part} is {record.views.get(part)}, cameras.json has {len(views)}"
    both = set(cameras["train"]) & set(cameras["test"])
    yield from (f"cameras.json: {name} is a training and a test view" for name in sorted(both))
    if not cameras["test"]:
        yield "cameras.json has no test view"


def row_problems(rows: dict[str, Row], cameras: dict[str, Any]) -> Iterator[str]:
    """Yield rows of views.csv that are missing, or of no test view."""
    yield from (f"views.csv has no row of the test view {name}" for name in cameras if name not in rows)
    yield from (f"views.csv has a row of {name}, which is no test view" for name in rows if name not in cameras)
