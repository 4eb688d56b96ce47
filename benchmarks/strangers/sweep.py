"""Run the cases of a strategy, in this process's own server, and sum up how they end."""

from __future__ import annotations

import atexit
import functools
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from benchmarks.strangers.cases import Case, outcome_of
from benchmarks.strangers.honest import Honest, make_honest
from benchmarks.strangers.models import pickle_cases, picture_cases, ply_cases
from benchmarks.strangers.packs import zip_cases
from benchmarks.strangers.records import record_cases, table_cases
from benchmarks.strangers.scenes import scene_cases
from benchmarks.strangers.server import Server

STRATEGIES: dict[str, Callable[[Honest], st.SearchStrategy[Case]]] = {
    "zip": zip_cases, "record": record_cases, "table": table_cases, "ply": ply_cases, "pickle": pickle_cases,
    "picture": picture_cases, "scene": scene_cases,
}  # fmt: skip


@dataclass
class Summary:
    """Of the cases of a strategy. found: number of cases by tool and problem. first: such a case."""

    cases: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    mb: float = 0.0
    found: Counter[tuple[str, str]] = field(default_factory=Counter)
    first: dict[tuple[str, str], str] = field(default_factory=dict)
    failures: int = 0

    def add(self, other: Summary) -> None:
        self.cases, self.failures = self.cases + other.cases, self.failures + other.failures
        self.statuses, self.found = self.statuses + other.statuses, self.found + other.found
        self.seconds, self.mb = max(self.seconds, other.seconds), max(self.mb, other.mb)
        self.first = {**other.first, **self.first}


@functools.cache
def _prepared(folder: Path) -> tuple[Server, Honest]:
    """Return this process's server and its honest files, in a new folder below `folder`."""
    server = Server()
    server.__enter__()
    atexit.register(server.__exit__)
    own = Path(tempfile.mkdtemp(prefix="strangers-", dir=folder))
    return server, make_honest(server, own / "honest")


def run_some(name: str, count: int, number: int, scratch: Path, out: Path) -> Summary:
    """Run some cases of a strategy; `number` seeds them."""
    server, honest = _prepared(scratch)
    summary = Summary()

    @seed(number)
    @settings(max_examples=count, database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(STRATEGIES[name](honest))
    def run(case: Case) -> None:
        if summary.cases >= count:
            return
        summary.cases += 1
        kept = out / f"{name}-{number}-{summary.cases}"
        outcome, found = outcome_of(server, case, honest.folder.with_name("case"), lambda: kept)
        summary.statuses[str(outcome.status if not outcome.signal else f"signal {outcome.signal}")] += 1
        summary.seconds, summary.mb = max(summary.seconds, outcome.seconds), max(summary.mb, outcome.mb)
        summary.failures += bool(found)
        for problem in found:
            key = (case.words[0] if case.words[0] != "data" else "data check", problem)
            summary.found[key] += 1
            summary.first.setdefault(key, f"{case.what} [{kept.name}]")

    run()
    return summary
