"""Methods and metrics of the user: tables print them as the plan of their folder says, and only where it is read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from math import inf
from typing import NamedTuple

from tdgbench.cells.plan import MethodEntry, MetricEntry, Plan
from tdgbench.scoring.metric import Measure


class OwnColumns(NamedTuple):
    """Entries of methods, and measures, by name."""

    methods: Mapping[str, MethodEntry]
    measures: Mapping[str, Measure]


_NONE = OwnColumns({}, {})
_own: ContextVar[OwnColumns] = ContextVar("own_columns", default=_NONE)


def own() -> OwnColumns:
    """Return what the innermost `own_columns` states; outside of it, nothing."""
    return _own.get()


@contextmanager
def own_columns(*plans: Plan) -> Iterator[None]:
    """Let tables print the own methods and metrics of these plans, and of no others, until the block ends.

    A name that tdgbench has keeps tdgbench's entry. If plans state a name differently, the last one counts.

    >>> with own_columns(*(Plan(own_methods={"mine": MethodEntry(label)}) for label in ("One", "Two"))):
    ...     own().methods["mine"].label
    'Two'
    >>> own().methods
    {}
    """
    entries = {name: entry for plan in plans for name, entry in plan.own_methods.items()}
    metrics = {name: _measure(name, entry) for plan in plans for name, entry in plan.own_metrics.items()}
    token = _own.set(OwnColumns(entries, metrics))
    try:
        yield
    finally:
        _own.reset(token)


def _measure(name: str, entry: MetricEntry) -> Measure:
    low, high = entry.limits
    limits = (-inf if low is None else low, inf if high is None else high)
    return Measure(name=name, **entry._replace(limits=limits)._asdict())
