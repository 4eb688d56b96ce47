"""What a record says about itself, its models, its log and its views."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from tdgbench.cells.cameras import Cameras
from tdgbench.cells.folder import CellFolder
from tdgbench.cells.key import cell_key
from tdgbench.cells.metric_settings import metric_settings
from tdgbench.cells.paths import CAMERAS_FILE, LOG_FILE, PARTS_FILE, RECORD_FILE, VIEWS_FILE, cell_folder_of, files_of
from tdgbench.cells.protocol import protocol_of
from tdgbench.cells.record import Record, schema_problems
from tdgbench.scenes.modalities import THERMAL
from tdgbench.scoring import TRAIN_METRICS, Scores

TIME_TOLERANCE = 0.002  # s; times are rounded to milliseconds


def field_problems(text: str) -> Iterator[str]:
    """Yield what does not fit the schema in the text of a record, and numbers that are none in JSON."""
    yield from (f"{RECORD_FILE}: {problem}" for problem in schema_problems(text))
    constants: list[str] = []
    json.loads(text, parse_constant=constants.append)
    yield from (f"{RECORD_FILE} holds {name}, which is no number in JSON" for name in dict.fromkeys(constants))


def place_problems(cell: CellFolder) -> Iterator[str]:
    """Yield the folder that the record belongs to, if it lies in another one."""
    place = cell_folder_of(Path(), cell.record)
    if cell.folder.absolute().parts[-len(place.parts) :] != place.parts:
        other = f"{RECORD_FILE} is of another cell: its folder is {place.as_posix()}"
        yield f"{other}; move it there, or run the cell again"


def key_problems(record: Record) -> Iterator[str]:
    """Yield a key that is not that of the recorded configuration, data, scene and code. A failed cell may have none."""
    if record.status == "failed" and not record.key:
        return
    expected = cell_key(record)
    if record.key != expected:
        yield f"{RECORD_FILE}: key is {record.key!r}, its configuration, data and code give {expected!r}"
    protocol = protocol_of(record.config, record.protocol_number)
    if record.protocol and record.protocol != protocol:
        yield f"{RECORD_FILE}: protocol is {record.protocol!r}, its settings give {protocol!r}"


def setting_problems(record: Record) -> Iterator[str]:
    """Yield fields that differ from the configuration, and settings of scores that are unknown."""
    stated = {"method.name": record.method, "init.name": record.init, "seed": record.seed}
    stated["metrics.convention"] = record.convention
    if record.prior is not None and record.setting("prior.made_from") is not None:  # 0.8.0 leaves it out
        stated["prior.made_from"] = record.prior_made_from
    for name, value in stated.items():
        if record.setting(name) != value:
            yield f"{RECORD_FILE}: {name} is {value!r}, its configuration has {record.setting(name)!r}"
    metric_settings(record.setting("metrics"))


def log_problems(record: Record, log: list[dict[str, float]]) -> Iterator[str]:
    """Check iterations, Gaussians and training time against the log."""
    if not log or record.made_elsewhere is not None:
        if log or record.made_elsewhere is None:
            yield f"{LOG_FILE} has {'rows, and nothing was trained' if log else 'no row'}"
        return
    iterations, last = [row["iteration"] for row in log], log[-1]
    if iterations != sorted(set(iterations)):
        yield f"{LOG_FILE}: its iterations do not increase"
    if last["iteration"] != record.iterations:
        yield f"{RECORD_FILE}: iterations is {record.iterations}, {LOG_FILE} ends at {last['iteration']:g}"
    planned = record.setting("budget.iterations")
    if isinstance(planned, int) and record.iterations > planned:
        yield f"{RECORD_FILE}: iterations is {record.iterations}, its configuration has {planned}"
    if last["gaussians"] != sum(record.gaussians.values()):
        yield f"{RECORD_FILE}: gaussians is {record.gaussians}, {LOG_FILE} ends with {last['gaussians']:g}"
    seconds = [row["seconds"] for row in log]
    if seconds != sorted(seconds):
        yield f"{LOG_FILE}: its seconds do not increase"
    if last["seconds"] > record.seconds["train"] + TIME_TOLERANCE:
        yield f"{RECORD_FILE}: seconds.train is {record.seconds['train']}, {LOG_FILE} ends at {last['seconds']}"


def model_problems(cell: CellFolder) -> Iterator[str]:
    """Check models against the recorded number of Gaussians."""
    record = cell.record
    has_none = record.made_elsewhere is not None or (cell.has_parts and not record.gaussians)
    needed = {} if has_none else {THERMAL: None}
    expected = {files_of(name).model: count for name, count in {**needed, **record.gaussians}.items()}
    for name in sorted({*expected, *cell.model_files()}):
        count = expected.get(name)
        if count is None:
            yield f"{RECORD_FILE}: gaussians has no count for {name}"
            continue
        try:
            rows = cell.model_rows(name)
            if rows != count:
                yield f"{RECORD_FILE}: gaussians has {count} for {name}, which holds {rows}"
        except (OSError, ValueError) as error:
            yield f"{name} cannot be read: {error}"


def parameter_problems(cell: CellFolder) -> Iterator[str]:
    """Check the recorded numbers of parameters against those of stored parts or, without any, of stored Gaussians."""
    stored: Mapping[str, Mapping[str, object]]
    try:
        if cell.has_parts:
            stored, file = cell.method().reports(), PARTS_FILE
        else:
            sizes = {name: sum(x.numel() for _, x in one.items()) for name, one in cell.models().items()}
            stored, file = {name: {"parameters": size} for name, size in sizes.items()}, "its model"
    except (OSError, ValueError):
        return  # renders cannot be made either, which is said there
    for name in sorted(stored):
        found, stated = (dict(one.get(name, {})).get("parameters") for one in (stored, cell.record.parts))
        if found != stated and cell.record.made_elsewhere is None:
            yield f"{RECORD_FILE}: parts.{name}.parameters is {stated}, {file} has {found}"


def train_score_problems(record: Record) -> Iterator[str]:
    """Yield scores of training views that are missing. (Their pictures are not stored; they are not computed again.)"""
    for metric in TRAIN_METRICS:
        if metric not in record.train_scores:
            yield f"{RECORD_FILE}: train_scores lacks {metric}"
        elif record.train_scores[metric] is None and not (record.missing.keys() & {metric, f"train_{metric}"}):
            yield f"{RECORD_FILE}: train_scores.{metric} is n/a without a reason"


def view_problems(record: Record, cameras: Cameras) -> Iterator[str]:
    """Check numbers of views against the cameras."""
    for part, views in cameras.items():
        if record.views.get(part) != len(views):
            yield f"{RECORD_FILE}: views.{part} is {record.views.get(part)}, {CAMERAS_FILE} has {len(views)}"
    both = set(cameras["train"]) & set(cameras["test"])
    yield from (f"{CAMERAS_FILE}: {name} is a training and a test view" for name in sorted(both))
    if not cameras["test"]:
        yield f"{CAMERAS_FILE} has no test view"


def row_problems(rows: dict[str, Scores], cameras: Iterable[str]) -> Iterator[str]:
    """Yield rows of views.csv that are missing, or of no test view."""
    yield from (f"{VIEWS_FILE} has no row of the test view {name}" for name in cameras if name not in rows)
    yield from (f"{VIEWS_FILE} has a row of {name}, which is no test view" for name in rows if name not in cameras)
