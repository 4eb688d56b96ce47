"""An experiment's plan and cells, from which tables are built; files that cannot be read are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import pandas as pd

from tdgbench.cells.folder import CellFolder, shared_content
from tdgbench.cells.paths import RECORD_FILE, VIEWS_FILE, cell_folder_of
from tdgbench.cells.plan import Plan, read_plan
from tdgbench.cells.record import READ_PHASE, Failure, Record, no_records, read_each
from tdgbench.scoring import METRICS
from tdgbench.tables import methods
from tdgbench.tables.likeness import machine
from tdgbench.tables.long_table import method_label, planned_iterations

Table = TypeVar("Table")
UNNAMED = "single"  # `name` in conf/config.yaml: runs of any scenes, which make no table together


class Cell(CellFolder):
    """A finished cell with the properties that comparisons need, and its tables as far as they are usable."""

    @property
    def label(self) -> str:
        """The method's column as it is printed, with the seed unless that is 0."""
        column = methods.label(method_label(self.record, with_init=True))
        return f"{column}, seed {self.record.seed}" if self.record.seed else column

    @property
    def planned_iterations(self) -> int:
        """The planned number of iterations; on a plateau training ends before."""
        return planned_iterations(self.record)

    @property
    def dataset_and_scene(self) -> tuple[str, str]:
        return self.record.dataset, self.record.scene

    @property
    def machine(self) -> tuple[str, ...]:
        return machine(self.record)

    @cached_property
    def log(self) -> pd.DataFrame | None:
        """The training log: iteration, seconds, smoothed_psnr (dB), loss_thermal, …; None if there is no usable one."""
        rows = _usable(self.read_log)
        return pd.DataFrame(rows) if rows else None

    @cached_property
    def views(self) -> pd.DataFrame | None:
        """Scores by the view's name, NaN for n/a; None if there are no usable ones."""
        rows = _usable(self.read_views)
        if rows is None:
            return None
        metrics = dict.fromkeys([*METRICS, *next(iter(rows.values()), ())])
        return pd.DataFrame(list(rows.values()), list(rows), list(metrics), dtype=float)


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
        return self.folder / "tables"

    @property
    def report(self) -> Path:
        return self.folder / "report.html"


def read_results(experiment: Path, of_last_run: bool = False) -> Results:
    """Read an experiment. A cell whose record cannot be read is a failed cell, with the reason; copies count once.

    of_last_run: of runs without a name, return only the cells of the last run's scenes, as tables show them. Raises
    ValueError, naming the folder, if it has neither records nor a plan.
    """
    problems: list[str] = []
    try:
        plan = read_plan(experiment)
    except (OSError, ValueError) as error:
        plan = Plan()
        problems.append(f"{error}; tables show the cells that have records")
    cells = _without_copies(_cells_in_place(experiment, problems), problems)
    if of_last_run and experiment.absolute().name == UNNAMED and plan.scenes:
        scenes = {(scene.dataset, scene.scene) for scene in plan.scenes}
        cells = [cell for cell in cells if cell.dataset_and_scene in scenes]
    if not cells and not plan.scenes:
        raise no_records(experiment)
    return Results(experiment, plan, cells, problems)


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
            failed = replace(record, status="failed", failure=Failure(READ_PHASE, problem, ""))
            found.setdefault(place, Cell(place, failed))
        else:
            found.setdefault(place, cell)
    return list(found.values())


def _without_copies(cells: list[Cell], problems: list[str]) -> list[Cell]:
    """Return the cells but those whose files and ground truth are another seed's: they are no further training.

    So are scores of one folder of renders under several seeds. Problems are added.
    """
    firsts: dict[tuple[str, ...], Cell] = {}
    copies = set[Path]()
    for cell in sorted(cells, key=lambda one: one.record.seed):
        content, column = shared_content(cell.record), method_label(cell.record, with_init=True)
        if not content or cell.record.failure is not None:
            continue
        first = firsts.setdefault((column, *cell.dataset_and_scene, content), cell)
        if first is not cell:
            copies.add(cell.folder)
            problems.append(
                f"{cell.record.title}: its files are those of seed {first.record.seed}; both count as one seed"
            )
    return [cell for cell in cells if cell.folder not in copies]


def _view_problems(cell: Cell) -> list[str]:
    """Return the problem of a finished cell's views.csv, if it is there but unusable."""
    path = cell.folder / VIEWS_FILE
    try:
        if cell.record.failure is None and path.exists() and not cell.read_views():
            raise ValueError("it has no views")
    except ValueError as error:
        return [f"{path} cannot be read: {error}; its scores have no interval ({RECORD_FILE} has the scores)"]
    return []
