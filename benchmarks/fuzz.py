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
from collections.abc import Iterator
from pathlib import Path

from tdgbench.__main__ import main as tdgbench
from tdgbench.experiments.measure.fuzz.case import Programs, find_kinds
from tdgbench.experiments.measure.fuzz.report import counts, line
from tdgbench.experiments.measure.fuzz.suite import Drawn, Suite, draw
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


if __name__ == "__main__":
    sys.exit(main())
