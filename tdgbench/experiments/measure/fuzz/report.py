"""Counts of cases by kind and outcome, as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from tdgbench.experiments.measure.fuzz.case import OUTCOMES
from tdgbench.experiments.measure.fuzz.suite import Finding


def counts(findings: Iterable[Finding]) -> str:
    """Table of the number of cases by kind and outcome, the peak of memory and the slowest case."""
    found = list(findings)
    if not found:
        return "0 cases"
    by_kind = Counter((one.drawn.kind.name, one.outcome) for one in found)
    kinds = [*sorted({kind for kind, _ in by_kind}), "all"]
    by_kind.update(("all", one.outcome) for one in found)
    lines = [" ".join([f"{'kind':12}", f"{'cases':>6}", *(f"{outcome:>9}" for outcome in OUTCOMES)])]
    for kind in kinds:
        numbers = [by_kind[kind, outcome] for outcome in OUTCOMES]
        lines.append(" ".join([f"{kind:12}", f"{sum(numbers):6}", *(f"{n or '.':>9}" for n in numbers)]))
    largest, slowest = max(found, key=lambda f: f.ran.megabytes), max(found, key=lambda f: f.ran.seconds)
    lines.append(f"peak memory {largest.ran.megabytes:.0f} MB (case {largest.drawn.number}, {largest.drawn.kind.name})")
    lines.append(f"slowest case {slowest.ran.seconds:.1f} s (case {slowest.drawn.number}, {slowest.drawn.kind.name})")
    broke = sum(one.broke for one in found)
    return "\n".join([*lines, f"{broke} of {len(found)} cases broke" if broke else f"none of {len(found)} cases broke"])


def line(finding: Finding) -> str:
    """A finding in one line."""
    what = "; ".join(change.text for change in finding.changes)
    return f"{finding.outcome}: case {finding.drawn.number}, {finding.drawn.kind.name}: {what}: {finding.why}"
