"""`python -m benchmarks.strangers`: thousands of strangers' files, each read in a watched child with 1 GB and 20 s.

Nothing in them may run code, hang, take more memory, open files elsewhere, or end in a traceback or a false success.
Exit status 1 if one does; its files and what was found are kept, a folder for each case.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from benchmarks.strangers.sweep import STRATEGIES, Summary, run_some

EACH = 25  # cases of a task


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strangers", description=__doc__)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--strategies", nargs="+", choices=STRATEGIES, default=list(STRATEGIES))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/strangers"), help="folder of the cases that fail")
    args = parser.parse_args()
    begin, all_of = time.monotonic(), {name: Summary() for name in args.strategies}
    each = -(-args.cases // len(args.strategies))
    sizes = [min(EACH, each - start) for start in range(0, each, EACH)]
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory(prefix="strangers-") as scratch,
        ProcessPoolExecutor(args.processes, context) as pool,
    ):
        tasks = {
            pool.submit(run_some, name, size, args.seed * 10_000 + number, Path(scratch), args.out.resolve()): name
            for number, size in enumerate(sizes)
            for name in args.strategies
        }
        for done in as_completed(tasks):
            all_of[tasks[done]].add(done.result())
    show(all_of)
    total, failures = (sum(getattr(one, what) for one in all_of.values()) for what in ("cases", "failures"))
    kept = f", kept in {args.out}" if failures else ""
    print(f"{failures} of {total} cases fail{kept} ({time.monotonic() - begin:.0f} s)")
    return int(failures > 0)


def show(all_of: dict[str, Summary]) -> None:
    print(f"{'strategy':<10}{'cases':>6}{'longest, s':>12}{'most, MB':>10}{'failures':>10}  statuses")
    for name, one in all_of.items():
        statuses = ", ".join(f"{status}: {count}" for status, count in sorted(one.statuses.items()))
        print(f"{name:<10}{one.cases:>6}{one.seconds:>12.1f}{one.mb:>10.0f}{one.failures:>10}  {statuses}")
    for name, one in all_of.items():
        for (tool, problem), count in one.found.most_common():
            print(f"{name}: {tool}: {count} × {problem}; {one.first[tool, problem]}")


if __name__ == "__main__":
    sys.exit(main())
