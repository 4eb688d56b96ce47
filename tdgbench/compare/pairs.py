"""Cells that two experiments share: the same place and seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

from tdgbench.cells.paths import VIEWS_FILE
from tdgbench.cells.record import Record
from tdgbench.tables.results import Cell

PLACE = ["dataset", "scene", "method", "init", "variant"]
Place = tuple[str, ...]  # values of PLACE
place_of: Callable[[Record], Place] = attrgetter(*PLACE)


class ComparedCell(NamedTuple):
    a: Cell
    b: Cell

    @property
    def is_one_training(self) -> bool:
        """Whether all files but the scores are equal, the log with its times among them: `score` and copies do that."""
        a, b = ({**cell.record.hashes, VIEWS_FILE: ""} for cell in self)
        return a == b and len(a) > 1


@dataclass(frozen=True)
class Pairs:
    """Pairs by place and seed, and the records of finished cells that only one experiment has."""

    by_place: dict[Place, dict[int, ComparedCell]]
    only_a: list[Record]
    only_b: list[Record]

    def __iter__(self) -> Iterator[ComparedCell]:
        return (pair for seeds in self.by_place.values() for pair in seeds.values())

    def __len__(self) -> int:
        return sum(len(seeds) for seeds in self.by_place.values())


def find_pairs(a: Iterable[Cell], b: Iterable[Cell]) -> Pairs:
    """Match the finished cells of two experiments."""
    mine, theirs = ({(place_of(cell.record), cell.record.seed): cell for cell in cells} for cells in (a, b))
    by_place: dict[Place, dict[int, ComparedCell]] = {}
    for place, seed in sorted(mine.keys() & theirs.keys()):
        by_place.setdefault(place, {})[seed] = ComparedCell(mine[place, seed], theirs[place, seed])
    alone = ([cells[key].record for key in sorted(cells.keys() - others.keys())]
             for cells, others in ((mine, theirs), (theirs, mine)))  # fmt: skip
    return Pairs(by_place, *alone)
