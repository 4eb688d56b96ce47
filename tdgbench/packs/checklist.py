"""What a reader expects of results that are handed on, beyond that they are whole: seeds, logs, one protocol."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tdgbench.cells.folder import RENDERS, CellFolder, read_cells, shared_content
from tdgbench.cells.paths import LOG_FILE
from tdgbench.cells.plan import read_plan
from tdgbench.cells.record import Record

FEWEST_SEEDS = 3  # of bold type too
OF_A_MACHINE = ("cpu", "cores", "platform", "python", "packages")


class Item(NamedTuple):
    """A line of the list. missing: of which cells it is, or how much, in words; empty if nothing is."""

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
        Item("all planned cells", f"{unfinished} of {planned}" if unfinished else ""),
        _item_of_seeds(records),
        Item("renders of all test views", of(_lacks_renders)),
        Item("files as the records state them", of(lambda cell: any(cell.file_problems(others=False)))),
        Item("one protocol", ", ".join(protocols) if len(protocols) != 1 else ""),
        Item("machine and packages", of(_states_no_machine)),
        Item("a commit of tdgbench without changes", of(_states_no_commit)),
        Item("a log of each training", of(lambda cell: not (cell.folder / LOG_FILE).exists())),
    ]


def _item_of_seeds(records: list[Record]) -> Item:
    """Return the line of seeds, which says how many the cells lack at most."""
    seeds = defaultdict(set)
    for one in {shared_content(one) or one.key or id(one): one for one in records}.values():  # copies are one training
        variant = f" [{one.variant}]" if one.variant else ""
        seeds[f"{one.method} on {one.dataset}/{one.scene}, {one.init}{variant}"].add(one.seed)
    lacks = {title: FEWEST_SEEDS - len(found) for title, found in seeds.items() if len(found) < FEWEST_SEEDS}
    most = ("up to " if len({*lacks.values()}) > 1 else "") + f"{max(lacks.values(), default=0)} of " if lacks else ""
    return Item(f"{most}{FEWEST_SEEDS} seeds of each cell", _first([*lacks]))


def _lacks_renders(cell: CellFolder) -> bool:
    renders = sum(name.startswith(f"{RENDERS}/") for name in cell.record.hashes)
    return renders != cell.record.views.get("test", 0)


def _states_no_machine(cell: CellFolder) -> bool:
    return not all(cell.record.environment.get(name) for name in OF_A_MACHINE)


def _states_no_commit(cell: CellFolder) -> bool:
    git = cell.record.environment.get("git")
    return not isinstance(git, dict) or bool(git.get("dirty", True))


def _first(titles: list[str]) -> str:
    """Return the first cell that lacks something, and how many more there are."""
    return f"{titles[0]}{f', and {len(titles) - 1} more' if titles[1:] else ''}" if titles else ""
