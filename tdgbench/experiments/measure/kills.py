"""Kill a sweep at random moments, resume it, and compare its results with those of an undisturbed sweep."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from tdgbench.bench.hashes import hashes_of_content
from tdgbench.bench.record import FILE, Record, read_all

ROOT = Path(__file__).resolve().parents[3]
MAY_DIFFER = ("seconds", "peak_rss_mb", "peak_gpu_mb", "environment", "resumed")


@dataclass
class Kill:
    """One kill: seconds after the start, number of finished cells and of checkpoints on disk."""

    seconds: float
    finished: int
    checkpoints: int


def contents(experiment: Path) -> dict[str, dict[str, object]]:
    """Parts of the records that kills must not change, by cell.

    These are all but times, memory, machine, and whether a prior was in the cache.
    """
    return {record.title: _content(record) for record in read_all(experiment)}


def _content(record: Record) -> dict[str, object]:
    content = {name: value for name, value in asdict(record).items() if name not in MAY_DIFFER}
    content["hashes"] = hashes_of_content(record.hashes)
    content["skips"] = [skip for skip in record.skips if skip["name"] != "prior"]
    return content


def start_sweep(sweep: list[str], results: Path) -> subprocess.Popen[bytes]:
    """Start a sweep in a new process group; its output goes to <results>.log."""
    command = [sys.executable, "-m", "tdgbench", *sweep, f"results={results}"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with (results.parent / f"{results.name}.log").open("ab") as out:
        return subprocess.Popen(
            command, cwd=results.parent, env=environment, start_new_session=True, stdout=out, stderr=subprocess.STDOUT
        )  # fmt: skip


def run_killed(
    sweep: list[str], experiment: Path, kills: int, pause: tuple[float, float], seed: int = 0
) -> tuple[list[Kill], list[str]]:
    """Start a sweep and kill it after a random pause (shortest, longest; seconds), several times; then let it end.

    Returns the kills, and problems: finished cells that were lost or ran again, an exit status that is not 0.
    """
    results = experiment.parent
    rng, finished = random.Random(seed), dict[Path, int]()
    found, problems = list[Kill](), list[str]()
    for _ in range(kills):
        process, seconds = start_sweep(sweep, results), rng.uniform(*pause)
        try:
            process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        before, finished = finished, _finished(experiment)
        problems += _changed(before, finished)
        found.append(Kill(seconds, len(finished), len(list((experiment / "checkpoints").glob("[!.]*.pt")))))
    if start_sweep(sweep, results).wait() != 0:
        problems.append("the last run did not end with status 0")
    return found, problems + _changed(finished, _finished(experiment))


def _finished(experiment: Path) -> dict[Path, int]:
    """Time at which each record was written, ns."""
    return {path: path.stat().st_mtime_ns for path in (experiment / "cells").rglob(FILE)}


def _changed(before: dict[Path, int], after: dict[Path, int]) -> list[str]:
    return [f"{path} was lost or written again" for path, time_ns in before.items() if after.get(path) != time_ns]


def compare(calm: Path, killed: Path) -> list[str]:
    """Differences of a killed experiment from an undisturbed one, and its leftover files."""
    a, b = contents(calm), contents(killed)
    problems = [f"{title} is only in one of them" for title in sorted(set(a) ^ set(b))]
    for title in sorted(set(a) & set(b)):
        problems += [f"{title}: {name} differs" for name, value in a[title].items() if b[title][name] != value]
    leftovers = [*(killed / "cells").rglob(".*"), *(killed / "checkpoints").glob("*")]
    return problems + [f"{path} is a leftover" for path in leftovers]
