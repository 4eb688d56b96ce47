"""The record of a cell: everything that is known about one result, as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from tdgbench.files import write_text

Status = Literal["ok", "failed"]
FILE = "record.json"
SCHEMA = 1


@dataclass
class Failure:
    """Why a cell has no scores."""

    stage: str
    error: str  # type and message
    traceback: str
    iteration: int | None = None  # of the first number that was not finite
    tensor: str | None = None


@dataclass
class Record:
    """One cell's result. Scores are means over the test views; None is n/a, for the reason in `missing`."""

    method: str
    dataset: str
    scene: str
    init: str
    seed: int
    experiment: str
    variant: str
    group: str = ""
    status: Status = "ok"
    key: str = ""
    data: str = ""  # fingerprint of the scene's files
    code: str = ""  # of the sources that the result depends on
    split: str = ""
    convention: str = ""
    iterations: int = 0
    resumed: list[int] = field(default_factory=list)  # iterations after which a killed training went on
    channels: int = 0
    temperature: list[float] | None = None  # °C that image values 0 and 1 stand for, where they do
    views: dict[str, int] = field(default_factory=dict)
    scores: dict[str, float | None] = field(default_factory=dict)
    train_scores: dict[str, float | None] = field(default_factory=dict)  # of the training views
    missing: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    gaussians: dict[str, int] = field(default_factory=dict)
    density: dict[str, dict[str, int]] = field(default_factory=dict)  # Gaussians cloned, split and pruned, by model
    peak_rss_mb: float | None = None  # of the process that finished the cell
    peak_gpu_mb: float | None = None  # what torch held of the GPU; None on the CPU
    init_points: dict[str, Any] = field(default_factory=dict)
    prior: dict[str, Any] | None = None
    backend: str = ""
    skips: list[dict[str, Any]] = field(default_factory=list)  # see tdgbench.training.skips.Skip
    notes: list[str] = field(default_factory=list)
    hashes: dict[str, str] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    failure: Failure | None = None
    schema: int = SCHEMA

    @property
    def title(self) -> str:
        """How messages name the cell."""
        extra = f" [{self.variant}]" if self.variant else ""
        return f"{self.method} on {self.dataset}/{self.scene}, {self.init}, seed {self.seed}{extra}"

    def write(self, folder: Path) -> None:
        """Write record.json, whole or not at all."""
        write_text(folder / FILE, json.dumps(asdict(self), indent=1, sort_keys=True, allow_nan=False) + "\n")


def read_record(folder: Path) -> Record | None:
    """The record in a cell's folder; None if there is none. Raises ValueError, naming the file, if it is broken."""
    path = folder / FILE
    try:
        content = json.loads(path.read_text())
        if content.get("schema") != SCHEMA:
            raise ValueError(f"its schema is {content.get('schema')}, this version reads {SCHEMA}")
        failure = content.pop("failure")
        return Record(**content, failure=None if failure is None else Failure(**failure))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path} is not a record: {error}; delete its folder to run the cell again") from error


def read_all(experiment: Path) -> list[Record]:
    """Every record below <experiment>/cells, in the order of their paths; hidden folders are not cells."""
    found = []
    for path in sorted((experiment / "cells").rglob(FILE)):
        if any(part.startswith(".") for part in path.relative_to(experiment).parts):
            continue
        record = read_record(path.parent)
        if record is not None:
            found.append(record)
    return found
