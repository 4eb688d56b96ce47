"""`python -m benchmarks.strangers`: thousands of strangers' files, each read in a watched child with 1 GB and 20 s.

Nothing in them may run code, hang, take more memory, open files elsewhere, or end in a traceback or a false success.
Exit status 1 if one does; its files and what was found are kept, a folder for each case.
"""

from __future__ import annotations

import argparse
import atexit
import functools
import multiprocessing
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from random import Random
from typing import NamedTuple

from benchmarks.strangers.cases import Case, run_case
from benchmarks.strangers.honest import Honest, make_honest
from benchmarks.strangers.models import pickle_cases, picture_cases, ply_cases
from benchmarks.strangers.packs import zip_cases
from benchmarks.strangers.records import record_cases, table_cases
from benchmarks.strangers.scenes import scene_cases
from benchmarks.strangers.server import Server

EACH = 25  # cases of a task
STRATEGIES: dict[str, Callable[[Random, Honest], Case]] = {
    "zip": zip_cases, "record": record_cases, "table": table_cases, "ply": ply_cases, "pickle": pickle_cases,
    "picture": picture_cases, "scene": scene_cases,
}  # fmt: skip


class Ended(NamedTuple):
    """How a case ended. case: in words, with the folder that is kept of one with problems. mb: of memory."""

    strategy: str
    case: str
    tool: str
    status: str
    seconds: float
    mb: float
    problems: list[str]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strangers", description=__doc__)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--strategies", nargs="+", choices=STRATEGIES, default=list(STRATEGIES))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/strangers"), help="folder of the cases that fail")
    args = parser.parse_args()
    begin, each = time.monotonic(), -(-args.cases // len(args.strategies))
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory(prefix="strangers-") as scratch,
        ProcessPoolExecutor(args.processes, context) as pool,
    ):
        numbers = [range(start, min(start + EACH, each)) for start in range(0, each, EACH)]
        places = Path(scratch), args.out.resolve()
        tasks = [pool.submit(run_some, name, some, args.seed, *places) for some in numbers for name in args.strategies]
        ended = [one for done in as_completed(tasks) for one in done.result()]
    show(ended)
    failures = sum(bool(one.problems) for one in ended)
    kept = f", kept in {args.out}" if failures else ""
    print(f"{failures} of {len(ended)} cases fail{kept} ({time.monotonic() - begin:.0f} s)")
    return int(failures > 0)


def show(ended: list[Ended]) -> None:
    print(f"{'strategy':<10}{'cases':>6}{'longest, s':>12}{'most, MB':>10}{'failures':>10}  statuses")
    for name in dict.fromkeys(one.strategy for one in ended):
        cases = [one for one in ended if one.strategy == name]
        seconds, mb = max(one.seconds for one in cases), max(one.mb for one in cases)
        failures, statuses = sum(bool(one.problems) for one in cases), Counter(one.status for one in cases)
        said = ", ".join(f"{status}: {count}" for status, count in sorted(statuses.items()))
        print(f"{name:<10}{len(cases):>6}{seconds:>12.1f}{mb:>10.0f}{failures:>10}  {said}")
    found: dict[tuple[str, str, str], list[str]] = {}
    for one in ended:
        for problem in one.problems:
            found.setdefault((one.strategy, one.tool, problem), []).append(one.case)
    for (name, tool, problem), where in sorted(found.items(), key=lambda item: -len(item[1])):
        print(f"{name}: {tool}: {len(where)} × {problem}; {where[0]}")


@functools.cache
def _prepared(folder: Path) -> tuple[Server, Honest]:
    """Return this process's server and its honest files, in a new folder below `folder`."""
    server = Server()
    server.__enter__()
    atexit.register(server.__exit__)
    own = Path(tempfile.mkdtemp(prefix="strangers-", dir=folder))
    return server, make_honest(server, own / "honest")


def run_some(name: str, numbers: range, seed: int, scratch: Path, out: Path) -> list[Ended]:
    """Run some cases of a strategy."""
    server, honest = _prepared(scratch)
    ended = []
    for number in numbers:
        case, kept = made(name, honest, seed, number), out / f"{name}-{seed}-{number}"
        outcome, found = run_case(server, case, honest.folder.with_name("case"), kept)
        tool = case.words[0] if case.words[0] != "data" else "data check"
        status = str(outcome.status if not outcome.signal else f"signal {outcome.signal}")
        ended.append(Ended(name, f"{case.what} [{kept.name}]", tool, status, outcome.seconds, outcome.mb, found))
    return ended


def made(name: str, honest: Honest, seed: int, number: int) -> Case:
    """Return a case of a strategy: the same one for the same seed and number."""
    return STRATEGIES[name](Random(f"{name} {seed} {number}"), honest)
