"""End a sweep at random moments, resume it, and look whether anything was lost, ran twice, or came out different."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from filelock import FileLock, Timeout

from benchmarks.killed import full_disk
from benchmarks.killed.compare import compare
from tdgbench.cells.record import record_files
from tdgbench.children import with_path

ROOT = Path(__file__).resolve().parents[2]
SIGNALS = ("SIGKILL", "SIGTERM", "SIGINT")
MAX_SECONDS = 300.0  # of a run that nothing ends
MAX_ABORT = 10.0  # seconds from SIGABRT to the end of the process
MAX_ENDING = 30.0  # seconds from SIGTERM or SIGINT to the end of the process


class Plan(NamedTuple):
    """How to disturb a sweep. full_disk: share of the kills that are a full disk instead of a signal."""

    kills: int
    signals: tuple[str, ...] = SIGNALS
    full_disk: float = 0.2
    seed: int = 0


@dataclass
class Kill:
    """One kill. at: seconds after the start, or number of the first write that failed. problems: what it broke."""

    how: str
    at: float
    status: int
    finished: int  # cells on disk afterwards
    checkpoints: int
    problems: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        where = f"write {self.at:.0f}" if self.how == "full disk" else f"{self.at:.1f} s"
        return f"{self.how} at {where}: status {self.status}, {self.finished} cells, {self.checkpoints} checkpoints"


class Calm(NamedTuple):
    """The undisturbed sweep: its experiment, its wall time, the number of its writes."""

    experiment: Path
    seconds: float
    writes: int


@dataclass(frozen=True)
class Sweep:
    """A sweep: Hydra's arguments without `results`, the name of the experiment, a scratch folder."""

    words: list[str]
    name: str
    scratch: Path

    def start(self, results: Path, full_at: int | None = None) -> subprocess.Popen[bytes]:
        """Start it in a new process group; its output goes to <results>.log. full_at: see full_disk.

        It trains on the CPU: bytes are compared, which a GPU need not repeat.
        """
        module = ["tdgbench"] if full_at is None else [full_disk.__name__, str(full_at), str(results)]
        command = [sys.executable, "-m", *module, *self.words, f"results={results}"]
        with _log(results).open("wb") as out:
            return subprocess.Popen(
                command, cwd=self.scratch, start_new_session=True,
                env={**with_path(ROOT), "PYTHONFAULTHANDLER": "1", "CUDA_VISIBLE_DEVICES": ""},
                stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
            )  # fmt: skip

    def run_calm(self, warm_up: bool = True) -> Calm:
        """Run it undisturbed. Raises RuntimeError if it fails.

        warm_up: run it once before, to make the data and compile the kernels, so that the wall time is that of a sweep.
        """
        start = time.monotonic()
        for name in ("first", "calm") if warm_up else ("calm",):
            start = time.monotonic()
            if self.start(self.scratch / name, 0).wait() != 0:
                raise RuntimeError(
                    f"the undisturbed sweep fails:\n{_log(self.scratch / name).read_text(encoding='utf-8')[-2000:]}"
                )
        writes = int((self.scratch / "calm.writes").read_text(encoding="utf-8"))
        return Calm(self.scratch / "calm" / self.name, time.monotonic() - start, writes)


def kill_many(sweep: Sweep, calm: Calm, plan: Plan, tell: Callable[[Kill], None] = lambda kill: None) -> list[Kill]:
    """Kill a sweep until it has ended, compare it, start a new one, until `plan.kills` kills are made.

    tell: called with each kill.
    """
    rng, kills = random.Random(plan.seed), list[Kill]()
    while len(kills) < plan.kills:
        results = sweep.scratch / "killed"
        of_this = list(_until_it_ends(sweep, calm, results, plan, rng, plan.kills - len(kills), tell))
        problems = _conclude(sweep, calm, results)
        for kill in of_this:
            kill.problems += problems
        kills += of_this
        shutil.rmtree(results, ignore_errors=True)
    return kills


def _until_it_ends(sweep: Sweep, calm: Calm, results: Path, plan: Plan, rng: random.Random, most: int,
                   tell: Callable[[Kill], None]) -> Iterator[Kill]:  # fmt: skip
    """Kills of one sweep, until a run of it ends before its kill, or there are `most`."""
    experiment = results / sweep.name
    before = _finished(experiment)
    for _ in range(most):
        full = rng.random() < plan.full_disk
        at = float(rng.randint(1, calm.writes)) if full else rng.uniform(0.0, calm.seconds)
        how = "full disk" if full else rng.choice(plan.signals)
        kill = _kill(sweep, results, how, at)
        after = _finished(experiment)
        kill.finished, kill.checkpoints = len(after), len(list((experiment / "checkpoints").glob("[!.]*.pt")))
        kill.problems += [
            f"{p.relative_to(results)} was lost or written again" for p, t in before.items() if after.get(p) != t
        ]
        kill.problems += [f"{path.name} is still locked" for path in _locked(experiment)]
        before = after
        if kill.status == 0:  # it ended before the kill, or the write that failed did not matter
            return
        tell(kill)
        yield kill


def _kill(sweep: Sweep, results: Path, how: str, at: float) -> Kill:
    """Start a sweep, and end it."""
    begin = time.time_ns()
    process = sweep.start(results, int(at) if how == "full disk" else None)
    try:
        process.wait(timeout=MAX_SECONDS if how == "full disk" else at)
    except subprocess.TimeoutExpired:
        if how in ("SIGKILL", "full disk"):
            os.killpg(process.pid, signal.SIGKILL)
        elif how == "SIGINT":
            os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does
        else:
            process.terminate()
    problems = []
    try:
        status = process.wait(timeout=MAX_ENDING)
    except subprocess.TimeoutExpired:
        status = _abort(process)
        said = _log(results).read_text(encoding="utf-8", errors="replace")
        problems.append(f"it did not end within {MAX_ENDING:.0f} s of {how}:\n{said}")
    problems += _wrong_end(
        how, status, _log(results).read_text(encoding="utf-8", errors="replace"), _began(results / sweep.name, begin)
    )
    return Kill(how, at, status, 0, 0, problems)


def _abort(process: subprocess.Popen) -> int:
    """End a process that does not end by itself; where it stands, in all threads, goes to its log."""
    process.send_signal(signal.SIGABRT)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=MAX_ABORT)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    return process.wait()


def _wrong_end(how: str, status: int, said: str, began: bool) -> Iterator[str]:
    """What is wrong with the end of a run: its status, its last words. began: it had begun its cells."""
    if status == 0 or (how == "SIGKILL" and status == -signal.SIGKILL):
        return
    if how == "full disk":
        if status != 1:
            yield f"status {status} with a full disk"
        if "No space left" not in said:
            yield "it does not say that the disk is full"
    elif how == "SIGKILL":
        yield f"it ended with status {status} by itself"
    else:
        number = signal.Signals[how]
        early = not began and status in (-number, 1)  # the interpreter's own ends, before the program has begun
        if status != 128 + number and not early:
            yield f"status {status}, not {128 + number}, after {how}"
    if "Traceback (most recent call last)" in said and (began or how == "full disk"):
        yield f"a traceback after {how}"


def _began(experiment: Path, since_ns: int) -> bool:
    """Whether a run wrote its plan."""
    plan = experiment / "experiment.json"
    return plan.exists() and plan.stat().st_mtime_ns >= since_ns


def _conclude(sweep: Sweep, calm: Calm, results: Path) -> list[str]:
    """Let the sweep end; what is wrong then."""
    before = _finished(results / sweep.name)
    status = sweep.start(results).wait(timeout=MAX_SECONDS)
    if status != 0:
        last = _log(results).read_text(encoding="utf-8", errors="replace")[-500:]
        return [f"the last run ended with status {status}: {last}"]
    after = _finished(results / sweep.name)
    lost = [
        f"{path.relative_to(results)} was lost or written again" for path, t in before.items() if after.get(path) != t
    ]
    return lost + compare(calm.experiment, results / sweep.name)


def _finished(experiment: Path) -> dict[Path, int]:
    """Time at which each record of a result was written, ns."""
    done = {}
    for path in record_files(experiment):
        with contextlib.suppress(ValueError):  # a broken record is no result
            if json.loads(path.read_text(encoding="utf-8"))["status"] == "ok":
                done[path] = path.stat().st_mtime_ns
    return done


def _locked(experiment: Path) -> Iterator[Path]:
    """Locks that are held although no process runs."""
    for path in sorted((experiment / "locks").glob("*.lock")):
        try:
            with FileLock(path).acquire(timeout=0):
                pass
        except Timeout:
            yield path


def _log(results: Path) -> Path:
    return results.with_name(f"{results.name}.log")
