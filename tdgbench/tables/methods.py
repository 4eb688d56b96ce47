"""How tables print a method, and what they compare it with: `label`, `order` and `compared_with` of its YAML file.

Files outside of tdgbench may be gone: plans of experiments keep what they said.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

from tdgbench.cells.plan import LAST, MethodEntry, method_entries
from tdgbench.resources import conf_folder
from tdgbench.tables.columns import own
from tdgbench.tables.published import published_main

PLAIN = "3dgs"  # what methods are compared with whose own baseline is not there


class MethodPair(NamedTuple):
    """A method and the method that it is compared with."""

    method: str
    baseline: str


def entry(name: str) -> MethodEntry:
    """Return a method's entry; without a file or a label, its name is printed.

    >>> entry("tdg_released").label, entry("unheard_of").label
    ('TDg as released', 'unheard_of')
    """
    return _entries().get(name, MethodEntry(name, LAST, None))


def label(column: str) -> str:
    """Return a column's method as it is printed; what follows the name (points, overrides) stays.

    >>> label("tdg (random)")
    'TDg (random)'
    """
    name, _, rest = column.partition(" ")
    return f"{entry(name).label} {rest}".strip()


def rank(column: str) -> tuple[int, str]:
    """Return the sorting key of a column: its method's `order`, then its name."""
    return entry(column.split(" ")[0]).order, column


def pairs() -> list[MethodPair]:
    """Return every method that names another one to be compared with, in the order of columns."""
    entries = _entries()
    named = [MethodPair(name, e.compared_with) for name, e in entries.items() if e.compared_with is not None]
    return sorted(named, key=lambda pair: rank(pair.method))


def baselines(columns: Iterable[str]) -> list[MethodPair]:
    """Return each column with the one that it is compared with: of the same points and options, its method's
    `compared_with`, else 3DGS. Columns that have neither beside them are left out.

    >>> baselines(["3dgs", "tdg", "tdg (random)"])
    [MethodPair(method='tdg', baseline='3dgs')]
    """
    columns, found = list(columns), []
    for column in sorted(columns, key=rank):
        name, space, rest = column.partition(" ")
        wanted = (f"{base}{space}{rest}" for base in (entry(name).compared_with, PLAIN) if base not in (None, name))
        found += [MethodPair(column, base) for base in wanted if base in columns][:1]
    return found


def paper_pair() -> MethodPair:
    """Return the pair of the published table, which the paper's claims are about.

    >>> paper_pair()
    MethodPair(method='tdg', baseline='msmg')
    """
    named = [pair for pair in pairs() if _published_methods().issuperset(pair)]
    if not named:
        raise ValueError(f"no method of {conf_folder() / 'method'} with `compared_with` is in the published table")
    return named[0]


@cache
def _published_methods() -> frozenset[str]:
    return frozenset(published_main()["method"])


def _entries() -> dict[str, MethodEntry]:
    return {**own().methods, **_of_conf(conf_folder())}


@cache
def _of_conf(conf: Path) -> dict[str, MethodEntry]:
    return method_entries(conf)
