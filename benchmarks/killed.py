"""`python -m benchmarks.killed`: a sweep killed with SIGKILL at random moments and gone on, against one left alone.

The demo by default, any sweep with overrides. Says of every kill what was done by then, and of the end whether
records, pictures and models are the same but for times, and whether a finished cell ran twice. Exit status 1 if not.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from tdgbench.bench.record import FILE, Record, read_all

ROOT = Path(__file__).resolve().parents[1]
MAY_DIFFER = ("seconds", "peak_rss_mb", "peak_gpu_mb", "environment", "resumed")


@dataclass
class Kill:
    """One kill: after so many seconds, with so many cells finished and checkpoints there."""

    seconds: float
    finished: int
    checkpoints: int


def contents(experiment: Path) -> dict[str, dict[str, object]]:
    """What must not depend on kills, by cell: everything of a record but times, memory, the machine, and whether a
    prior was in the cache."""
    return {record.title: _content(record) for record in read_all(experiment)}


def _content(record: Record) -> dict[str, object]:
    content = {name: value for name, value in asdict(record).items() if name not in MAY_DIFFER}
    content["skips"] = [skip for skip in record.skips if skip["name"] != "prior"]
    return content


def start(sweep: list[str], results: Path) -> subprocess.Popen[bytes]:
    """The sweep in a process group of its own."""
    call = [sys.executable, "-m", "tdgbench", *sweep, f"results={results}"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with (results.parent / f"{results.name}.log").open("ab") as out:
        return subprocess.Popen(
            call, cwd=results.parent, env=environment, start_new_session=True, stdout=out, stderr=subprocess.STDOUT
        )  # fmt: skip


def run_killed(
    sweep: list[str], results: Path, name: str, kills: int, pause: tuple[float, float], seed: int = 0
) -> tuple[list[Kill], list[str]]:
    """Start the sweep and kill it, again and again, each time after a random pause; then let it end.

    Returns the kills and what went wrong: finished cells that were lost or made again, a status that is not 0.
    """
    chance, seen = random.Random(seed), dict[Path, int]()
    told, wrong = list[Kill](), list[str]()
    for _ in range(kills):
        process, seconds = start(sweep, results), chance.uniform(*pause)
        try:
            process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        there = _made(results / name)
        wrong += _made_again(seen, there)
        seen = there
        told.append(Kill(seconds, len(there), len(list((results / name / "checkpoints").glob("[!.]*.pt")))))
    if start(sweep, results).wait() != 0:
        wrong.append("the last run did not end with status 0")
    wrong += _made_again(seen, _made(results / name))
    return told, wrong


def _made(experiment: Path) -> dict[Path, int]:
    """When each record was written."""
    return {path: path.stat().st_mtime_ns for path in (experiment / "cells").rglob(FILE)}


def _made_again(before: dict[Path, int], after: dict[Path, int]) -> list[str]:
    return [f"{path} was made again" for path, time_ns in before.items() if after.get(path) != time_ns]


def compare(calm: Path, killed: Path) -> list[str]:
    """How a killed experiment differs from one that was left alone, and what it left lying about."""
    a, b = contents(calm), contents(killed)
    wrong = [f"{title} is only in one of them" for title in sorted(set(a) ^ set(b))]
    for title in sorted(set(a) & set(b)):
        wrong += [f"{title}: {name} differs" for name, value in a[title].items() if b[title][name] != value]
    left = [*(killed / "cells").rglob(".*"), *(killed / "checkpoints").glob("*")]
    return wrong + [f"{path} is left over" for path in left]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.killed", description=__doc__)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--pause", type=float, nargs=2, default=(5.0, 30.0), help="shortest and longest, in seconds")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--name", default="demo", help="the experiment's folder")
    parser.add_argument("sweep", nargs="*", default=["+experiment=demo", "checkpoint=2"], help="Hydra overrides")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        calm, killed = Path(scratch) / "calm", Path(scratch) / "killed"
        begin = time.perf_counter()
        if start(asked.sweep, calm).wait() != 0:
            print(f"the sweep fails by itself:\n{(Path(scratch) / 'calm.log').read_text()[-2000:]}", file=sys.stderr)
            return 1
        print(f"left alone: {time.perf_counter() - begin:.0f} s, {len(contents(calm / asked.name))} cells")
        kills, wrong = run_killed(asked.sweep, killed, asked.name, asked.kills, tuple(asked.pause), asked.seed)
        for kill in kills:
            print(f"killed after {kill.seconds:.1f} s: {kill.finished} cells done, {kill.checkpoints} checkpoints")
        wrong += compare(calm / asked.name, killed / asked.name)
        resumed = {r.title: r.resumed for r in read_all(killed / asked.name) if r.resumed}
    for title, iterations in resumed.items():
        print(f"{title}: went on after iteration {', '.join(map(str, iterations))}")
    for problem in wrong:
        print(f"wrong: {problem}")
    print("same records, renders and models; nothing finished ran twice" if not wrong else f"{len(wrong)} problems")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
