"""An experiment's plan and records, from which tables are built; files that cannot be read are named."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from tdgbench.bench.signature import as_typed
from tdgbench.cells.folder import CellFolder
from tdgbench.cells.key import flat
from tdgbench.cells.paths import RECORD_FILE, VIEWS_FILE, cell_folder_of
from tdgbench.cells.plan import Plan, read_plan
from tdgbench.cells.protocol import protocols_apart
from tdgbench.cells.record import READ_PHASE, Failure, Record, read_each

UNNAMED = "single"  # `name` in conf/config.yaml: runs of any scenes, which make no table together


@dataclass(frozen=True)
class Results:
    """Plan, records by cell (each cell once), and what could not be read."""

    plan: Plan
    records: list[Record]
    problems: list[str] = field(default_factory=list)


def read_results(experiment: Path) -> Results:
    """Read an experiment. A cell whose record cannot be read is a failed cell, with the reason.

    Of runs without a name, only the cells of the last run's scenes are returned.
    """
    problems: list[str] = []
    try:
        plan = read_plan(experiment)
    except (OSError, ValueError) as error:
        plan = Plan()
        problems.append(f"{error}; tables show the cells that have records")
    by_folder: dict[Path, Record] = {}
    for folder, record in read_each(experiment):
        if record.failure is not None and record.failure.phase == READ_PHASE:
            problems.append(record.failure.error)
        place = cell_folder_of(experiment, record)
        if place == folder:
            by_folder[place] = record
            problems += _view_problems(folder, record)
        elif record.failure is None:
            problem = f"{folder / RECORD_FILE} is in another cell's folder; move it to {place}, or delete it"
            problems.append(f"{record.title}: {problem}")
            by_folder.setdefault(place, replace(record, status="failed", failure=Failure(READ_PHASE, problem, "")))
        else:
            by_folder.setdefault(place, record)
    records = list(by_folder.values())
    if experiment.absolute().name == UNNAMED and plan.scenes:
        scenes = {(scene.dataset, scene.scene) for scene in plan.scenes}
        records = [record for record in records if (record.dataset, record.scene) in scenes]
    problems += _trained_apart(records)
    return Results(plan, _of_one_protocol(records, problems), problems)


def _trained_apart(records: list[Record]) -> list[str]:
    """Return a problem for each cell whose seeds have other options, so that their mean is of unlike trainings."""
    cells: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        if record.failure is None:
            place = (record.method, record.dataset, record.scene, record.init, record.variant)
            cells.setdefault(place, []).append(record)
    problems = []
    for cell in cells.values():
        options = [flat({k: v for k, v in record.config.items() if k != "metrics"}) for record in cell]
        apart = [
            name for name in options[0]
            if name.rpartition(".")[2] != "seed" and len({as_typed(one.get(name)) for one in options}) > 1
        ]  # fmt: skip
        if apart:
            values = ", ".join(dict.fromkeys(as_typed(one.get(apart[0])) for one in options))
            more = f" and {len(apart) - 1} more" if len(apart) > 1 else ""
            problems.append(
                f"{cell[0].title}: its seeds have different options ({apart[0]}: {values}{more}), and tables show "
                "their mean: run them with the same, or delete those that are not meant"
            )
    return problems


def _of_one_protocol(records: list[Record], problems: list[str]) -> list[Record]:
    """Return the records; in each column of tables, cells that follow another protocol than most are failed ones."""
    columns: dict[tuple[str, str, str, str], list[Record]] = {}
    for record in records:
        if record.failure is None:
            columns.setdefault((record.method, record.dataset, record.init, record.variant), []).append(record)
    apart: dict[str, Record] = {}
    for column in columns.values():
        usual = Counter(record.protocol for record in column).most_common(1)[0][0]
        example = next(record for record in column if record.protocol == usual)
        for record in column:
            difference = protocols_apart(record, example)
            if difference:
                problem = (
                    f"its protocol is {record.protocol or 'without a number'}, that of most cells of its column "
                    f"{usual or 'without one'} ({difference}): scores of two protocols do not compare; run it again"
                )
                problems.append(f"{record.title}: {problem}")
                apart[record.title] = replace(record, status="failed", failure=Failure("score", problem, ""))
    return [apart.get(record.title, record) for record in records]


def _view_problems(folder: Path, record: Record) -> list[str]:
    """Return the problem of a finished cell's views.csv, if it is there but unusable."""
    try:
        if record.failure is None and (folder / VIEWS_FILE).exists() and not CellFolder(folder, record).read_views():
            raise ValueError("it has no views")
    except ValueError as error:
        return [
            f"{folder / VIEWS_FILE} cannot be read: {error}; its scores have no interval ({RECORD_FILE} has the scores)"
        ]
    return []
