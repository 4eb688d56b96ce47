"""How tables print a method, and what they compare it with: `label`, `order` and `compared_with` of its YAML file.

The file's keys count as they stand there; a method does not inherit them from the files that it builds on.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import OmegaConf

from tdgbench.resources import conf_folder
from tdgbench.tables.published import published_main

LAST = 1000  # order of a method that names none


class MethodEntry(NamedTuple):
    """How tables print a method, as its file says: label, order of its column, baseline."""

    label: str
    order: int
    compared_with: str | None


class MethodPair(NamedTuple):
    """A method and the method that it is compared with."""

    method: str
    baseline: str


def entry(name: str) -> MethodEntry:
    """Return a method's entry; without a file or a label, its name is printed.

    >>> entry("tdg_released").label, entry("unheard_of").label
    ('TDg as released', 'unheard_of')
    """
    return _entries(conf_folder()).get(name, MethodEntry(name, LAST, None))


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
    entries = _entries(conf_folder())
    named = [MethodPair(name, e.compared_with) for name, e in entries.items() if e.compared_with is not None]
    return sorted(named, key=lambda pair: rank(pair.method))


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


@cache
def _entries(conf: Path) -> dict[str, MethodEntry]:
    entries = {}
    for path in sorted((conf / "method").glob("*.yaml")):
        content: Any = OmegaConf.load(path)
        name = str(content.get("name", path.stem))
        entries[name] = MethodEntry(
            str(content.get("label", name)), int(content.get("order", LAST)), content.get("compared_with")
        )
    return entries
