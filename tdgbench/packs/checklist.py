"""What a reader expects of results that are handed on, beyond that they are whole: seeds, logs, one protocol."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

from tdgbench.cells.paths import files_of
from tdgbench.cells.plan import read_plan
from tdgbench.cells.record import read_each
from tdgbench.cells.stored import file_problems
from tdgbench.scenes.modalities import THERMAL

FEWEST_SEEDS = 3  # of which a spread can be stated
OF_A_MACHINE = ("cpu", "cores", "platform", "python", "packages")


class Item(NamedTuple):
    """A line of the list. missing: what is, in words; empty if nothing is."""

    title: str
    missing: str


def checklist(experiment: Path) -> list[Item]:
    """Return the list for a results folder."""
    cells = read_each(experiment)
    done = [(folder, record) for folder, record in cells if record.failure is None]
    finished = [record for _, record in done]
    seeds = defaultdict(set)
    for record in finished:
        seeds[record.title.replace(f", seed {record.seed}", "")].add(record.seed)
    few = [title for title, found in seeds.items() if len(found) < FEWEST_SEEDS]
    planned = max(read_plan(experiment).cells_with_data, len(cells))  # some may be of an earlier plan
    unfinished = planned - len(finished)
    protocols = sorted({record.protocol for record in finished})
    pictures = f"{files_of(THERMAL).renders}/"
    fewer = [r.title for r in finished if sum(n.startswith(pictures) for n in r.hashes) != r.views.get("test", 0)]
    changed = [r.title for folder, r in done if any(file_problems(folder, r.hashes, others=False))]
    unknown = [r.title for r in finished if not all(r.environment.get(name) for name in OF_A_MACHINE)]
    edited = [r.title for r in finished if not r.environment.get("git") or r.environment["git"]["dirty"]]
    logs = [r.title for folder, r in done if not (folder / "log.csv").exists()]
    return [
        Item("every planned cell is finished", f"{unfinished} of {planned} cells" if unfinished else ""),
        Item(f"{FEWEST_SEEDS} seeds of each cell", _first(few)),
        Item("all test views are there", _first(fewer)),
        Item("the files are those of the records", _first(changed)),
        Item("one protocol", ", ".join(protocols) if len(protocols) != 1 else ""),
        Item("machine and packages are stated", _first(unknown)),
        Item("a commit without changes made it", _first(edited)),
        Item("a log of each training", _first(logs)),
    ]


def _first(titles: list[str]) -> str:
    return f"{titles[0]}{f', and {len(titles) - 1} more' if titles[1:] else ''}" if titles else ""
