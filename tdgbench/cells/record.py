"""`record.json`: everything known about one cell. The types here are also the schema of the file."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, with_config
from pydantic_core import PydanticCustomError
from typing_extensions import TypedDict  # pydantic refuses that of typing before Python 3.12

from tdgbench.cells.paths import RECORD_FILE
from tdgbench.cells.prior_sources import Source, source_of
from tdgbench.cells.read_files import read_text
from tdgbench.files import write_text
from tdgbench.scenes.registry import ORIGIN, is_built_in
from tdgbench.text import one_line, shortened

SCHEMA: Literal[2] = 2
CLOSED = ConfigDict(extra="forbid", allow_inf_nan=False)
READ_PHASE = "read"  # of the failure that stands for a record that cannot be read
LARGEST = 2**63 - 1
LARGEST_SCORE = 1e12  # of any metric and unit
MOST_SHOWN = 60  # characters of a wrong value
MOST_ASSUMED, MOST_DOUBTS, MOST_STATED = 32, 64, 1000  # keys, doubts, characters of each
VALUES, PALETTE = "values", "palette"  # key of `assumed`, and how its text begins where images are pseudo-colour

Status = Literal["ok", "failed"]
Text = Annotated[str, Field(min_length=1)]
Name = Annotated[str, Field(min_length=1, max_length=MOST_SHOWN)]
Statement = Annotated[str, Field(min_length=1, max_length=MOST_STATED)]
Integer = Annotated[int, Field(ge=-LARGEST, le=LARGEST)]
Count = Annotated[int, Field(ge=0, le=10**12)]
Positive = Annotated[int, Field(ge=1, le=10**12)]
Seconds = Annotated[float, Field(ge=0, le=1e9)]
Share = Annotated[float, Field(ge=0, le=1)]
Megabytes = Annotated[float, Field(ge=0, le=1e9)]
Celsius = Annotated[float, Field(ge=-1e6, le=1e6)]
Key = Annotated[str, Field(pattern="^([0-9a-f]{32})?$")]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Scores = dict[str, Annotated[float, Field(ge=-LARGEST_SCORE, le=LARGEST_SCORE)] | None]


@with_config(CLOSED)
class SkipRecord(TypedDict):
    """Fields of tdgbench.training.skips.Skip."""

    name: Text
    allowed: bool
    taken: bool
    reason: str
    saved: str


@with_config(ConfigDict(extra="allow", allow_inf_nan=False))
class PartReport(TypedDict, total=False):
    """What `report` of a part of the training says; other parts than Gaussians have other fields."""

    gaussians: Count
    parameters: Count
    cloned: Count
    split: Count
    pruned: Count
    background: list[float]  # (C,) image value behind the Gaussians; left out: black
    settled_at: Count  # of a curriculum: the iteration at which its training settled; 0: it did not
    checks: list[
        list[Annotated[int | float, Field(ge=-LARGEST_SCORE, le=LARGEST_SCORE)]]
    ]  # of held-out views: iteration, scale of the images, mean PSNR in dB
    reason: Text  # why it settled


@with_config(ConfigDict(extra="allow", allow_inf_nan=False))
class MadeElsewhere(TypedDict):
    """What `made_elsewhere` of a method says."""

    files: Text
    summary: Text


@dataclass
class Failure:
    """Why a cell has no scores."""

    __pydantic_config__: ClassVar[ConfigDict] = CLOSED

    phase: str
    error: str  # type and message
    traceback: str
    iteration: Integer | None = None  # of the first number that was not finite
    tensor: str | None = None
    of_environment: bool = False  # disk, memory, device: the next run tries again


@dataclass
class Record:
    """Result of one cell. Scores are means over the test views; None is n/a, for the reason in `missing`."""

    __pydantic_config__: ClassVar[ConfigDict] = CLOSED

    method: Text
    dataset: str
    scene: str
    init: str
    seed: Integer
    experiment: str
    variant: str
    group: str = ""
    status: Status = "ok"
    key: Key = ""
    data: str = ""  # `scene_files`, and the fingerprint of files of its renders, model or prior behind a `-`
    code: str = ""  # fingerprint of the sources that the result depends on
    split: str = ""
    protocol: str = ""  # `protocol_number`-hash of options; empty in records made before protocols had numbers
    convention: str = ""
    iterations: Count = 0
    resumed: list[Positive] = field(default_factory=list)  # iterations of the checkpoints used
    channels: Literal[0, 1, 3] = 0  # of the thermal images; 0: not loaded
    temperature_range: Annotated[list[Celsius], Field(min_length=2, max_length=2)] | None = None  # °C of 0 and 1
    views: dict[str, Count] = field(default_factory=dict)
    masked: dict[str, Share] = field(default_factory=dict)  # share of the pixels without a thermal value, as `views`
    scores: Scores = field(default_factory=dict)
    train_scores: Scores = field(default_factory=dict)  # of the training views
    missing: dict[str, Text] = field(default_factory=dict)
    seconds: dict[str, Seconds] = field(default_factory=dict)
    train_processor_seconds: Seconds | None = None  # of all threads: less than wall time depends on other work
    parts: dict[str, PartReport] = field(default_factory=dict)  # facts about each part of the training, by name
    peak_rss_mb: Megabytes | None = None  # of the process that finished the cell
    peak_gpu_mb: Megabytes | None = None  # reserved by torch; None on the CPU
    init_points: dict[str, Any] = field(default_factory=dict)
    prior: dict[str, Any] | None = None
    thermal_camera: dict[str, dict[str, Any]] = field(default_factory=dict)  # `estimated`: response; `rig`: trial
    made_elsewhere: MadeElsewhere | None = None  # of a method that does not train: it has no training time, no log
    backend: str = ""
    skips: list[SkipRecord] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    # how the scene's files were read where they could be read otherwise; records of earlier versions do not say it
    assumed: Annotated[dict[Name, Statement], Field(max_length=MOST_ASSUMED)] = field(default_factory=dict)
    doubts: Annotated[list[Statement], Field(max_length=MOST_DOUBTS)] = field(default_factory=list)
    has_doubts_of_its_own: bool = False  # about its depth prior or its renders, beside those about the scene
    hashes: dict[str, Sha256] = field(default_factory=dict)
    truth: dict[str, Sha256] = field(default_factory=dict)  # of each test view's ground truth as scored; `truth_hash`
    environment: dict[str, Any] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    failure: Failure | None = None
    schema: Literal[2] = SCHEMA

    @property
    def why_failed(self) -> str:
        """Why the cell has no scores, in one line; empty for a finished cell.

        >>> Record("tdg", "paper", "Truck", "colmap", 0, "", "", failure=Failure("train", "no memory", "")).why_failed
        'failed in train: no memory'
        """
        if self.failure is None:
            return ""
        error = (self.failure.error.splitlines() or [""])[0]
        return error if self.failure.phase == READ_PHASE else f"failed in {self.failure.phase}: {error}"

    @property
    def gaussians(self) -> dict[str, int]:
        """Number of Gaussians of each part that has them."""
        return {name: report["gaussians"] for name, report in self.parts.items() if "gaussians" in report}

    @property
    def in_palette(self) -> bool:
        """Whether the thermal images are pseudo-colour, so that scores compare colours of a palette.

        A record of an earlier version tells by its channels, unless three of them were asked for, as for gray images.

        >>> place = ("tdg", "paper", "Truck", "colmap", 0, "table1", "")
        >>> Record(*place, channels=3).in_palette, Record(*place, channels=3, assumed={"values": "gray"}).in_palette
        (True, False)
        """
        if self.assumed:
            return self.assumed.get(VALUES, "").startswith(PALETTE)
        skips, channels = self.setting("skip"), self.setting("dataset.options.channels")
        skips = skips if isinstance(skips, dict) else {}
        return self.channels == 3 and channels != 3 and skips.get("gray", skips.get("otherwise", True)) is not False

    @property
    def is_of_built_in_scene(self) -> bool:
        """Whether the scene is built into tdgbench, also if its files were read as those of a capture."""
        return is_built_in(self.dataset) or ORIGIN in self.assumed

    @property
    def has_made_up_points(self) -> bool:
        """Whether its initial points are the sparse points of a built-in scene, which COLMAP did not find."""
        return self.is_of_built_in_scene and self.init_points.get("kind") == "colmap"

    @property
    def scene_files(self) -> str:
        """Fingerprint of the scene's files."""
        return self.data.partition("-")[0]

    @property
    def further_files(self) -> str:
        """Fingerprint of the files that its depth prior, or its renders, were read from; empty without such."""
        return self.data.partition("-")[2]

    @property
    def protocol_number(self) -> str:
        """Version of the protocol, without the hash of its options."""
        return self.protocol.partition("-")[0]

    @property
    def prior_made_from(self) -> str:
        """What its depth prior is made from, as the prior's file says; empty without one, or where it is not stated."""
        return str((self.prior or {}).get("made_from") or "")

    @property
    def prior_source(self) -> Source:
        """What that means for its scores."""
        return source_of(self.prior_made_from, self.is_of_built_in_scene)

    def setting(self, name: str) -> Any:
        """Return the value of a setting by its dotted name; None if the record has none.

        >>> Record("tdg", "", "a", "", 0, "", "", config={"budget": {"iterations": 9}}).setting("budget.iterations")
        9
        """
        value: Any = self.config
        for part in name.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        return value

    @property
    def title(self) -> str:
        """Name of the cell in messages.

        >>> Record("tdg", "paper", "Truck", "colmap", 0, "table1", "").title
        'tdg on paper/Truck, colmap, seed 0'
        """
        extra = f" [{self.variant}]" if self.variant else ""
        return f"{self.method} on {self.dataset}/{self.scene}, {self.init}, seed {self.seed}{extra}"

    def write(self, folder: Path) -> None:
        """Write record.json, whole or not at all."""
        write_text(folder / RECORD_FILE, json.dumps(asdict(self), indent=1, sort_keys=True, allow_nan=False) + "\n")


def read_record(folder: Path) -> Record | None:
    """Read the record in a cell's folder; None without one.

    Raises ValueError, naming the file, for anything else: types are checked, and whether status and failure agree.
    """
    path = folder / RECORD_FILE
    try:
        return _validator().validate_json(read_text(path), strict=True)
    except FileNotFoundError:
        return None
    except ValueError as error:
        problem = _problems(error)[0] if isinstance(error, ValidationError) else error
        raise ValueError(f"{path} is not a record: {problem}; delete its folder to run the cell again") from error


def readable_record(folder: Path) -> Record | None:
    """Return the record in a folder; None if there is none, or if it is broken and the cell has to run again."""
    try:
        return read_record(folder)
    except ValueError:
        return None


def read_all(experiment: Path) -> list[Record]:
    """Read every record below <experiment>/cells, in the order of their paths, hidden folders excepted.

    A record that cannot be read is one of a failed cell, with the reason; its cell's names are those of its folders.
    """
    return [record for _, record in read_each(experiment)]


def read_each(experiment: Path) -> list[tuple[Path, Record]]:
    """Return the cell's folder and record for each record of `read_all`."""
    found = []
    for path in record_files(experiment):
        try:
            record = read_record(path.parent)
        except ValueError as error:
            record = _unreadable(experiment, path.parent, str(error))
        if record is not None:  # None: its cell was moved away just now
            found.append((path.parent, record))
    return found


def _unreadable(experiment: Path, folder: Path, error: str) -> Record:
    """Return the record of a failed cell in the place of one that cannot be read."""
    *_, method, dataset, scene, init, last = ("", "", "", "", *folder.relative_to(experiment / "cells").parts)
    seed, _, variant = last.removeprefix("seed").partition(",")
    number = int(seed) if seed.isascii() and seed.isdigit() and len(seed) < 19 else 0
    record = Record(method or "unknown", dataset, scene, init, number, experiment.name, variant, status="failed")
    record.failure = Failure(READ_PHASE, f"its record cannot be read: {error}", "")
    return record


def record_files(experiment: Path) -> list[Path]:
    """Return paths of the records below <experiment>/cells, sorted, hidden folders excepted."""
    paths = sorted((experiment / "cells").rglob("*.json"))  # with a wildcard, broken links are listed as well
    paths = [path for path in paths if path.name == RECORD_FILE]
    return [path for path in paths if not any(part.startswith(".") for part in path.relative_to(experiment).parts)]


def no_records(experiment: Path) -> ValueError:
    """Return the error of a folder without records."""
    if experiment.is_dir():
        images = any(path.suffix in (".png", ".npy") for path in experiment.iterdir())
        scored = f"images: tdgbench method=renders method.folder={shlex.quote(str(experiment))} scene=SCENE scores them"
        return ValueError(f"{experiment} holds {scored if images else 'no records; run an experiment first'}")
    return ValueError(f"{experiment} is {'no folder' if experiment.exists() else 'not there'}")


def schema_problems(text: str) -> list[str]:
    """Return reasons why the JSON text of a record does not fit `Record`; none if it does.

    >>> schema_problems('{"method": 1, "schema": 2, "failure": null}')[0]
    '$.method: Input should be a valid string, not 1'
    """
    try:
        _validator().validate_json(text, strict=True)
    except ValidationError as error:
        return _problems(error)
    return []


@cache
def _validator() -> TypeAdapter[Record]:
    return TypeAdapter(Annotated[Record, BeforeValidator(_check_schema), AfterValidator(_check_status)])


def _check_schema(content: Any) -> Any:
    """Check that a record states its schema and its failure, if only as null."""
    if isinstance(content, dict) and content.get("schema") != SCHEMA:
        problem = f"its schema is {content.get('schema')}, this version reads {SCHEMA}"
        raise PydanticCustomError("schema", "{problem}", {"problem": problem})
    if isinstance(content, dict) and "failure" not in content:
        raise PydanticCustomError("missing", "lacks failure")
    return content


def _check_status(record: Record) -> Record:
    """Check that a failed cell has a failure, and a finished one its training time."""
    problem = ""
    if (record.status == "failed") != (record.failure is not None):
        problem = f"status is {record.status}, but failure is {'' if record.failure is None else 'not '}null"
    elif record.failure is None and record.made_elsewhere is None and "train" not in record.seconds:
        problem = "status is ok, but it lacks seconds.train"
    if problem:
        raise PydanticCustomError("status", "{problem}", {"problem": problem})
    return record


def _problems(error: ValidationError) -> list[str]:
    """Return a line for each problem: where, what, and the value unless it is an object or an array."""
    found = []
    for problem in error.errors(include_url=False):
        place, value = ".".join(["$", *map(str, problem["loc"])]), problem["input"]
        shown = "" if isinstance(value, dict | list) else f", not {shortened(repr(value), MOST_SHOWN)}"
        found.append(f"{place}: {one_line(problem['msg'])}{shown}")
    return found
