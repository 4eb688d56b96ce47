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
    """Pairs by place and seed, and the records of cells that finished in one experiment alone.

    failed_a: of A, whose cell finished in B; failed_b: likewise. failed_both: of A, of cells that failed in both.
    """

    by_place: dict[Place, dict[int, ComparedCell]]
    only_a: list[Record]
    only_b: list[Record]
    failed_a: list[Record]
    failed_b: list[Record]
    failed_both: list[Record]

    def __iter__(self) -> Iterator[ComparedCell]:
        return (pair for seeds in self.by_place.values() for pair in seeds.values())

    def __len__(self) -> int:
        return sum(len(seeds) for seeds in self.by_place.values())


def find_pairs(a: Iterable[Cell], b: Iterable[Cell]) -> Pairs:
    """Match the cells of two experiments."""
    cells = [{(place_of(cell.record), cell.record.seed): cell for cell in of_one} for of_one in (a, b)]
    mine, theirs = ({key: one for key, one in of_one.items() if one.record.failure is None} for of_one in cells)
    by_place: dict[Place, dict[int, ComparedCell]] = {}
    for place, seed in sorted(mine.keys() & theirs.keys()):
        by_place.setdefault(place, {})[seed] = ComparedCell(mine[place, seed], theirs[place, seed])
    only_a, only_b = sorted(mine.keys() - theirs.keys()), sorted(theirs.keys() - mine.keys())
    return Pairs(
        by_place, [mine[key].record for key in only_a], [theirs[key].record for key in only_b],
        [cells[0][key].record for key in only_b if key in cells[0]],
        [cells[1][key].record for key in only_a if key in cells[1]],
        [one.record for key, one in sorted(cells[0].items(), key=lambda item: item[0])
         if key not in mine and key in cells[1] and key not in theirs],
    )  # fmt: skip
