"""A table of numbers as readers see it: LaTeX, terminal, report, comparison and site render one grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple


class GridCell(NamedTuple):
    """One number of a grid.

    text: with the standard deviation, if it has one; mean: without. value, std: NaN for n/a. sort: number or text to
    sort by, empty for n/a. title: why it is n/a, or behind its verdict. note: ours − published, with its verdict.
    published: the published number and its verdict, in words. interval: 95 %, over seeds and views, in words.
    """

    text: str = "n/a"
    mean: str = "n/a"
    value: float = math.nan
    sort: float | str = ""
    bold: bool = False
    title: str = ""
    note: str = ""
    verdict: str = ""
    published: str = ""
    std: float = math.nan
    interval: str = ""


class GridRow(NamedTuple):
    """Numbers of one place. heads: the names that are shown. place: the names on disk, as the grid's `heads` order.

    is_marked: whether the images are in a palette.
    """

    heads: tuple[str, ...]
    cells: tuple[GridCell, ...]
    place: tuple[str, ...] = ()
    group: str = ""
    is_marked: bool = False


@dataclass(frozen=True)
class Grid:
    """Rows of numbers. heads: titles of the rows' heads. columns: titles of the numbers. notes: lines below.

    names: the columns' names on disk.
    """

    heads: Sequence[str]
    columns: Sequence[str]
    rows: list[GridRow]
    notes: Sequence[str] = field(default_factory=list)
    names: Sequence[str] = ()
