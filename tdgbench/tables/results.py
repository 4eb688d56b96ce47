"""An experiment's plan and cells, from which tables are built; files that cannot be read are named."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import pandas as pd

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.key import flat
from tdgbench.cells.paths import RECORD_FILE, VIEWS_FILE, cell_folder_of
from tdgbench.cells.plan import Plan, read_plan
from tdgbench.cells.protocol import protocols_apart
from tdgbench.cells.record import READ_PHASE, Failure, Record, no_records, read_each
from tdgbench.scoring import METRICS
from tdgbench.tables.long_table import method_label, planned_iterations
from tdgbench.text import as_typed

Table = TypeVar("Table")
UNNAMED = "single"  # `name` in conf/config.yaml: runs of any scenes, which make no table together


class Cell(CellFolder):
    """A finished cell with the properties that comparisons need, and its tables as far as they are usable."""

    @property
    def label(self) -> str:
        """The label of the method's column, with the seed unless that is 0."""
        return method_label(self.record, with_init=True) + (f", seed {self.record.seed}" if self.record.seed else "")

    @property
    def planned_iterations(self) -> int:
        """The planned number of iterations; on a plateau training ends before."""
        return planned_iterations(self.record)

    @property
    def dataset_and_scene(self) -> tuple[str, str]:
        return self.record.dataset, self.record.scene

    @property
    def machine(self) -> tuple[str, ...]:
        """The hardware that times depend on."""
        return tuple(str(self.record.environment.get(name)) for name in ("cpu", "gpu", "threads"))

    @property
    def settings_key(self) -> str:
        """All settings but method, prior, init, seed and number of iterations."""
        config = {k: v for k, v in self.record.config.items() if k not in ("method", "prior", "init", "seed", "budget")}
        whole = self.record.setting("budget")
        budget = {k: v for k, v in whole.items() if k not in ("iterations", "name")} if isinstance(whole, dict) else {}
        place = [*self.dataset_and_scene, self.record.data, self.record.split]
        return json.dumps([*place, config, budget], sort_keys=True)

    @cached_property
    def log(self) -> pd.DataFrame | None:
        """The training log: iteration, seconds, smoothed_psnr (dB), loss_thermal, …; None if there is no usable one."""
        rows = _usable(self.read_log)
        return pd.DataFrame(rows) if rows else None

    @cached_property
    def views(self) -> pd.DataFrame | None:
        """Scores by the view's name, NaN for n/a; None if there are no usable ones."""
        rows = _usable(self.read_views)
        return None if rows is None else pd.DataFrame(list(rows.values()), list(rows), list(METRICS), dtype=float)


def _usable(read: Callable[[], Table]) -> Table | None:
    """Return the rows of a cell's file; None where it is missing or unusable."""
    try:
        return read()
    except (OSError, ValueError):
        return None


@dataclass(frozen=True)
class Results:
    """Plan and cells of an experiment (each cell once), and what could not be read."""

    folder: Path
    plan: Plan
    cells: list[Cell]
    problems: list[str] = field(default_factory=list)

    @property
    def records(self) -> list[Record]:
        return [cell.record for cell in self.cells]

    @property
    def finished(self) -> list[Cell]:
        """The cells that have scores."""
        return [cell for cell in self.cells if cell.record.failure is None]

    @property
    def tables(self) -> Path:
        """The folder of the tables."""
        return self.folder / "tables"


def read_results(experiment: Path) -> Results:
    """Read an experiment. A cell whose record cannot be read is a failed cell, with the reason.

    Of runs without a name, only the cells of the last run's scenes are returned. Raises ValueError, naming the folder,
    if it has neither records nor a plan.
    """
    problems: list[str] = []
    try:
        plan = read_plan(experiment)
    except (OSError, ValueError) as error:
        plan = Plan()
        problems.append(f"{error}; tables show the cells that have records")
    cells = _cells_in_place(experiment, problems)
    if experiment.absolute().name == UNNAMED and plan.scenes:
        scenes = {(scene.dataset, scene.scene) for scene in plan.scenes}
        cells = [cell for cell in cells if cell.dataset_and_scene in scenes]
    if not cells and not plan.scenes:
        raise no_records(experiment)
    problems += _unlike_seeds(cells)
    return Results(experiment, plan, _of_one_protocol(cells, problems), problems)


def _cells_in_place(experiment: Path, problems: list[str]) -> list[Cell]:
    """Return the cells, each once. A record in another cell's folder is that of a failure. Problems are added."""
    found: dict[Path, Cell] = {}
    for folder, record in read_each(experiment):
        if record.failure is not None and record.failure.phase == READ_PHASE:
            problems.append(record.failure.error)
        place = cell_folder_of(experiment, record)
        cell = Cell(place, record)
        if place == folder:
            found[place] = cell
            problems += _view_problems(cell)
        elif record.failure is None:
            problem = f"{folder / RECORD_FILE} is in another cell's folder; move it to {place}, or delete it"
            problems.append(f"{record.title}: {problem}")
            found.setdefault(place, _failed(cell, READ_PHASE, problem))
        else:
            found.setdefault(place, cell)
    return list(found.values())


def _unlike_seeds(cells: Sequence[Cell]) -> list[str]:
    """Return a problem for each cell whose seeds have other options, so that their mean is of unlike trainings."""
    by_place: dict[tuple[str, ...], list[Record]] = {}
    for record in (cell.record for cell in cells if cell.record.failure is None):
        place = (record.method, record.dataset, record.scene, record.init, record.variant)
        by_place.setdefault(place, []).append(record)
    problems = []
    for seeds in by_place.values():
        options = [flat({k: v for k, v in record.config.items() if k != "metrics"}) for record in seeds]
        differ = [
            name for name in options[0]
            if name.rpartition(".")[2] != "seed" and len({as_typed(one.get(name)) for one in options}) > 1
        ]  # fmt: skip
        if differ:
            values = ", ".join(dict.fromkeys(as_typed(one.get(differ[0])) for one in options))
            more = f" and {len(differ) - 1} more" if len(differ) > 1 else ""
            problems.append(
                f"{seeds[0].title}: its seeds have different options ({differ[0]}: {values}{more}), and tables show "
                "their mean: run them with the same, or delete those that are not meant"
            )
    return problems


def _of_one_protocol(cells: Sequence[Cell], problems: list[str]) -> list[Cell]:
    """Return the cells; in each column of tables, those that follow another protocol than most are failed ones."""
    columns: dict[tuple[str, str, str, str], list[Record]] = {}
    for record in (cell.record for cell in cells if cell.record.failure is None):
        columns.setdefault((record.method, record.dataset, record.init, record.variant), []).append(record)
    refused: dict[str, str] = {}
    for column in columns.values():
        usual = Counter(record.protocol for record in column).most_common(1)[0][0]
        example = next(record for record in column if record.protocol == usual)
        for record in column:
            difference = protocols_apart(record, example)
            if difference:
                refused[record.title] = (
                    f"its protocol is {record.protocol or 'without a number'}, that of most cells of its column "
                    f"{usual or 'without one'} ({difference}): scores of two protocols do not compare; run it again"
                )
    problems += [f"{title}: {problem}" for title, problem in refused.items()]
    titles = [cell.record.title for cell in cells]
    return [
        _failed(cell, "score", refused[title]) if title in refused else cell
        for cell, title in zip(cells, titles, strict=True)
    ]


def _failed(cell: Cell, phase: str, problem: str) -> Cell:
    return Cell(cell.folder, replace(cell.record, status="failed", failure=Failure(phase, problem, "")))


def _view_problems(cell: Cell) -> list[str]:
    """Return the problem of a finished cell's views.csv, if it is there but unusable."""
    path = cell.folder / VIEWS_FILE
    try:
        if cell.record.failure is None and path.exists() and not cell.read_views():
            raise ValueError("it has no views")
    except ValueError as error:
        return [f"{path} cannot be read: {error}; its scores have no interval ({RECORD_FILE} has the scores)"]
    return []
