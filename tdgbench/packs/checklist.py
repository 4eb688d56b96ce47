"""What a reader expects of results that are handed on, beyond that they are whole: seeds, logs, one protocol."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tdgbench.cells.folder import RENDERS, CellFolder, read_cells
from tdgbench.cells.paths import LOG_FILE
from tdgbench.cells.plan import read_plan
from tdgbench.cells.record import Record

FEWEST_SEEDS = 3  # of which a spread can be stated
OF_A_MACHINE = ("cpu", "cores", "platform", "python", "packages")


class Item(NamedTuple):
    """A line of the list. missing: what is, in words; empty if nothing is."""

    title: str
    missing: str


def checklist(experiment: Path) -> list[Item]:
    """Return the list for a results folder."""
    cells = read_cells(experiment)
    finished = [cell for cell in cells if cell.record.failure is None]
    records = [cell.record for cell in finished]
    planned = max(read_plan(experiment).cells_with_data, len(cells))  # some may be of an earlier plan
    unfinished, protocols = planned - len(finished), sorted({record.protocol for record in records})

    def of(lacks: Callable[[CellFolder], bool]) -> str:
        return _first([cell.record.title for cell in finished if lacks(cell)])

    return [
        Item("every planned cell is finished", f"{unfinished} of {planned} cells" if unfinished else ""),
        Item(f"{FEWEST_SEEDS} seeds of each cell", _first(_cells_of_few_seeds(records))),
        Item("all test views are there", of(_lacks_renders)),
        Item("the files are those of the records", of(lambda cell: any(cell.file_problems(others=False)))),
        Item("one protocol", ", ".join(protocols) if len(protocols) != 1 else ""),
        Item("machine and packages are stated", of(_states_no_machine)),
        Item("a commit of tdgbench without changes made it", of(_states_no_commit)),
        Item("a log of each training", of(lambda cell: not (cell.folder / LOG_FILE).exists())),
    ]


def _cells_of_few_seeds(records: list[Record]) -> list[str]:
    """Return titles, without the seed, of cells that have too few."""
    seeds = defaultdict(set)
    for record in records:
        seeds[record.title.replace(f", seed {record.seed}", "")].add(record.seed)
    return [title for title, found in seeds.items() if len(found) < FEWEST_SEEDS]


def _lacks_renders(cell: CellFolder) -> bool:
    renders = sum(name.startswith(f"{RENDERS}/") for name in cell.record.hashes)
    return renders != cell.record.views.get("test", 0)


def _states_no_machine(cell: CellFolder) -> bool:
    return not all(cell.record.environment.get(name) for name in OF_A_MACHINE)


def _states_no_commit(cell: CellFolder) -> bool:
    git = cell.record.environment.get("git")
    return not git or git["dirty"]


def _first(titles: list[str]) -> str:
    """Return the first cell that lacks something, and how many more there are."""
    return f"{titles[0]}{f', and {len(titles) - 1} more' if titles[1:] else ''}" if titles else ""
