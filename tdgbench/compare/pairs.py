"""Cells that two experiments share: the same place and seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

from tdgbench.cells.folder import is_same_training
from tdgbench.cells.paths import VIEWS_FILE
from tdgbench.cells.record import Record
from tdgbench.tables.results import Cell

PLACE = ["dataset", "scene", "method", "init", "variant"]
Place = tuple[str, ...]  # values of PLACE
Key = tuple[Place, int]  # place, seed
place_of: Callable[[Record], Place] = attrgetter(*PLACE)


class ComparedCell(NamedTuple):
    a: Cell
    b: Cell

    @property
    def is_one_training(self) -> bool:
        """Whether both are of one training, as `score` and copies make them, by files that are more than scores."""
        return bool({*self.a.record.hashes} - {VIEWS_FILE}) and is_same_training(self.a.record, self.b.record)


@dataclass(frozen=True)
class Pairs:
    """Pairs by place and seed, and the records of cells that finished in one experiment alone.

    failed_a: of A, of cells that finished or are absent in B; failed_b: likewise. failed_both: of A.
    """

    by_place: dict[Place, dict[int, ComparedCell]]
    only_a: list[Record]
    only_b: list[Record]
    failed_a: list[Record]
    failed_b: list[Record]
    failed_both: list[Record]

    @property
    def sides(self) -> tuple[list[Record], list[Record]]:
        """The records of the pairs, A's and B's."""
        return [pair.a.record for pair in self], [pair.b.record for pair in self]

    def __iter__(self) -> Iterator[ComparedCell]:
        return (pair for seeds in self.by_place.values() for pair in seeds.values())

    def __len__(self) -> int:
        return sum(len(seeds) for seeds in self.by_place.values())


def find_pairs(a: Iterable[Cell], b: Iterable[Cell]) -> Pairs:
    """Match the cells of two experiments."""
    all_a, all_b = ({(place_of(cell.record), cell.record.seed): cell for cell in cells} for cells in (a, b))
    mine, theirs = ({key: one for key, one in cells.items() if one.record.failure is None} for cells in (all_a, all_b))
    failed_a, failed_b = all_a.keys() - mine.keys(), all_b.keys() - theirs.keys()
    by_place: dict[Place, dict[int, ComparedCell]] = {}
    for place, seed in sorted(mine.keys() & theirs.keys()):
        by_place.setdefault(place, {})[seed] = ComparedCell(mine[place, seed], theirs[place, seed])

    def records(cells: Mapping[Key, Cell], keys: Iterable[Key]) -> list[Record]:
        return [cells[key].record for key in sorted(keys)]

    return Pairs(
        by_place,
        only_a=records(mine, mine.keys() - theirs.keys()),
        only_b=records(theirs, theirs.keys() - mine.keys()),
        failed_a=records(all_a, failed_a - failed_b),
        failed_b=records(all_b, failed_b - failed_a),
        failed_both=records(all_a, failed_a & failed_b),
    )
