"""How readers call cells, and which of them say what: `said`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tdgbench.cells.record import Record
from tdgbench.scenes.registry import LABELS
from tdgbench.tables import methods
from tdgbench.tables.long_table import method_label
from tdgbench.text import named

Fact = Callable[[Record], str]


def said(fact: Fact, records: Sequence[Record]) -> list[str]:
    """Return what records say of a fact; with the methods, scenes or cells that say it, where not all agree.

    >>> cells = [Record(name, "", "a", "colmap", 0, "", "", backend=name[0]) for name in ("tdg", "msmg", "mmone")]
    >>> said(lambda record: record.backend, cells)
    ['t (TDg)', 'm (MSMG, MMOne)']
    """
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(fact(record), []).append(record)
    if len(groups) == 1:
        return list(groups)
    for name in (_method, _scene, method_on_scene, cell_title):
        names = [dict.fromkeys(map(name, group)) for group in groups.values()]
        if sum(map(len, names)) == len({one for group in names for one in group}):  # no name says two things
            break
    return [f"{text} ({named(group)})" for text, group in zip(groups, names, strict=True)]


def _method(record: Record) -> str:
    return methods.label(method_label(record, with_init=True))


def _scene(record: Record) -> str:
    return LABELS.get(record.scene, record.scene)


def method_on_scene(record: Record) -> str:
    return f"{_method(record)} on {_scene(record)}"


def cell_title(record: Record) -> str:
    """Return a cell's name as readers see it.

    >>> cell_title(Record("tdg", "paper", "Truck", "random", 1, "", ""))
    'TDg (random) on Truck, seed 1'
    """
    return f"{method_on_scene(record)}, seed {record.seed}"
