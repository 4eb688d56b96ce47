"""`python -m benchmarks.fuzz --minutes N`: mutated inputs, each in a child with limits of 20 s and 3 GB.

Allowed are a result that verifies, or one clear error that names file or option. Everything else is printed, shrunk and
kept. A seed and a number name a case: `--seed 0 --case 1234` runs it again. Exit status 1 if a case broke. Linux only.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from benchmarks.fuzz.case import OUTCOMES, Programs, find_kinds
from benchmarks.fuzz.suite import Drawn, Finding, Suite, draw
from tdgbench.__main__ import main as tdgbench
from tdgbench.tools import TOOLS


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="start no case after this time")
    parser.add_argument("--cases", type=int, help="end after this many cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", nargs="+", choices=list(find_kinds()), help="only cases of these kinds")
    parser.add_argument("--case", type=int, help="run one case and print its output")
    parser.add_argument("--keep", type=Path, default=Path("results/fuzz"), help="folder of the cases that broke")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--all", action="store_true", help="print every case, not only those that broke")
    args = parser.parse_args()
    findings, end = [], time.monotonic() + 60 * args.minutes
    with tempfile.TemporaryDirectory() as scratch:
        kinds = [find_kinds()[name] for name in args.kind or find_kinds()]
        chosen = kinds if args.case is None else [draw(args.seed, args.case).kind]
        results = any(kind.needs_results for kind in chosen)
        suite = Suite(Programs(tdgbench, TOOLS["verify"].run), Path(scratch), results=results)
        for finding in suite.run(_cases(args, end), args.jobs):
            findings.append(finding)
            if args.case is not None:
                print(finding.ran.output)
            if finding.broke or args.all or args.case is not None:
                print(line(finding), flush=True)
        findings = [suite.confirm(finding) for finding in findings]
        for finding in findings:
            if finding.broke:
                suite.shrink(finding, args.keep)
    print(counts(findings))
    return int(any(finding.broke for finding in findings))


def _cases(args: argparse.Namespace, end: float) -> Iterator[Drawn]:
    """The cases of a seed, in order, until time or number is used up."""
    if args.case is not None:
        yield draw(args.seed, args.case)
        return
    drawn = (draw(args.seed, number) for number in itertools.count())
    chosen = (one for one in drawn if args.kind is None or one.kind.name in args.kind)
    for one in itertools.islice(chosen, args.cases):
        if time.monotonic() > end:
            return
        yield one


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


if __name__ == "__main__":
    sys.exit(main())
