"""Progress of a cell (phase, loss, PSNR, Gaussians, time left): a bar, or a few lines; its outcome in one line."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from tdgbench.cells.record import Record, read_all
from tdgbench.scoring import METRICS
from tdgbench.text import duration, one_line
from tdgbench.training.loop import LogLine
from tdgbench.training.trainer import LastIteration

INTERVAL = 60.0  # least number of seconds between two lines on one cell


class CellProgress:
    """One cell after the other: `begin`, then the other calls, then `end`.

    On a terminal, a bar that is gone at the end. Elsewhere (a file, a pipe, SLURM's log) plain lines, each of which
    names its cell, since several processes may print to one file: one at the start, then at most one a minute. The time
    left is that at the pace since the line before, "at most" while a rule may end the training sooner.

    clock: seconds, for the lines. cells_at_once: that share the machine, and the terminal, where lines then show each;
    None where a queue decides.
    """

    def __init__(
        self,
        console: Console,
        iterations: int,
        clock: Callable[[], float] = time.monotonic,
        cells_at_once: int | None = 1,
    ) -> None:
        self._console, self._iterations, self._clock = console, iterations, clock
        self.cells_at_once = cells_at_once
        self._shows_bar = console.is_interactive and cells_at_once == 1
        self._mark: tuple[float, int] | None = None  # time and count from which the pace is measured
        self._reset("")

    def begin(self, title: str) -> None:
        """Begin a cell, which may turn out to be finished already."""
        self._reset(title)
        self._bar.start()

    def rename(self, title: str) -> None:
        self._title = title
        self._bar.update(self._task, description=title)

    def start(self, views: int, is_limit: bool = False) -> None:
        """Say that the cell has to run: it trains on so many views. is_limit: a rule may end the training sooner."""
        if not self._shows_bar:
            self.say(f"starts, {'at most ' * is_limit}{self._iterations} iterations on {views} training views")

    def phase(self, name: str) -> None:
        self._phase, self._mark = name, None
        if name == "train":
            self._bar.reset(self._task, total=self._iterations)
        self._bar.update(self._task, state=name)
        if self._is_due():
            self.say(f"phase {name}")

    def count(self, done: int, total: int) -> None:
        """Show how many of a phase's views are done."""
        self._bar.update(self._task, completed=done, total=total)
        self._report(done, total, f"{self._phase}, {done} of {total} views")

    def line(self, line: LogLine, last: LastIteration) -> None:
        """Show a line of the training log. last: as the trainer knows it by now."""
        numbers = [f"loss {line.loss:.4f}", f"PSNR {line.psnr:.1f} dB"]
        numbers += [f"{line.gaussians:,} Gaussians"] if line.gaussians else []
        at_most = "at most " * last.is_limit
        self._bar.update(
            self._task, completed=line.iteration, total=last.number, state="  ".join(numbers), at_most=at_most.strip()
        )
        state = f"iteration {line.iteration} of {at_most}{last.number}, {', '.join(numbers)}"
        self._report(line.iteration, last.number, state, at_most or "about ")

    def end(self) -> None:
        self._bar.stop()

    def _reset(self, title: str) -> None:
        self._title, self._phase = title, ""
        self._last = self._clock()  # time of the last line
        self._mark = None
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:>3.0f}%"),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[at_most]}"),
            TimeRemainingColumn(),
            console=self._console if self._shows_bar else Console(quiet=True),
            transient=True,
            disable=not self._shows_bar,
        )
        self._task = self._bar.add_task(title, total=None, state="", at_most="")

    def _report(self, done: int, total: int, state: str, how_sure: str = "about ") -> None:
        """Print what the phase has done, if a line is due. how_sure: words before the time left."""
        now = self._clock()
        if self._is_due():
            self.say(state + self._left(now, done, total, how_sure))
            self._mark = now, done
        self._mark = self._mark or (now, done)

    def _left(self, now: float, done: int, total: int, how_sure: str) -> str:
        if self._mark is None or done <= self._mark[1]:
            return ""
        then, before = self._mark
        return f", {how_sure}{duration((total - done) * (now - then) / (done - before))} left"

    def _is_due(self) -> bool:
        return not self._shows_bar and self._clock() - self._last >= INTERVAL

    def say(self, state: str) -> None:
        """Print a line about the cell."""
        self._last = self._clock()
        self._console.print(Text(one_line(f"{self._title}: {state}")), soft_wrap=True)


Status = Literal["ok", "kept", "failed", "missing", "no prior", "elsewhere"]
WORDS: dict[Status, str] = {
    "ok": "done",
    "kept": "already there",
    "failed": "failed",
    "missing": "without data",
    "no prior": "failed, it has no depth prior",
    "elsewhere": "running in another process",
}
COMPLETE: tuple[Status, ...] = ("ok", "kept")  # the cell has a result
SUCCESS: tuple[Status, ...] = (*COMPLETE, "elsewhere")  # nothing went wrong
ONCE = "compile"  # phase that only the first cell of a machine spends time in


@dataclass(frozen=True)
class Outcome:
    """Outcome of a cell.

    status: `ok` (it ran), `kept` (its result was there), `failed`, `missing` (its scene is not on disk), `no prior` (it
    failed because its depth prior is not available), or `elsewhere` (another process runs it). scores, seconds: in
    words, and how long such a cell takes; of `ok` alone.
    """

    status: Status
    title: str
    message: str = ""
    scores: str = ""
    seconds: float = 0.0

    @property
    def line(self) -> str:
        """The outcome in one line.

        >>> Outcome("ok", "tdg on a", "resumed after iteration 9", "PSNR 24.06 dB").line
        'tdg on a: done, PSNR 24.06 dB (resumed after iteration 9)'
        >>> Outcome("failed", "tdg on a", "train: no memory").line
        'tdg on a: failed (train: no memory)'
        """
        scores = f", {self.scores}" if self.scores else ""
        first = self.message.partition("\n")[0]
        remark = f" ({first})" if first and self.status in ("ok", "failed", "kept") else ""
        return f"{self.title}: {WORDS[self.status]}{scores}{remark}"


def finished(record: Record, message: str) -> Outcome:
    """Return the outcome of a cell that ran."""
    seconds = sum(time for phase, time in record.seconds.items() if phase != ONCE)
    return Outcome("ok", record.title, message, scores_in_words(record), seconds)


def finished_records(experiment: Path, outcomes: Iterable[Outcome]) -> list[Record]:
    """Return the results of these cells in an experiment's folder, which may hold those of earlier runs, too.

    Cells that another process ran are among them if they have ended.
    """
    titles = {outcome.title for outcome in outcomes if outcome.status in SUCCESS}
    return [record for record in read_all(experiment) if record.failure is None and record.title in titles]


def scores_in_words(record: Record) -> str:
    """Return the published scores of a finished cell, and its training time, or who made it elsewhere.

    >>> scores_in_words(Record("tdg", "", "a", "", 0, "", "", scores={"psnr": 24.061}, seconds={"train": 754.0}))
    'PSNR 24.06 dB, SSIM n/a, LPIPS n/a, trained in 0:12:34'
    """
    parts = [f"{m.label} {m.as_text(record.scores.get(m.name))}" for m in METRICS.values() if m.in_main_table]
    made = record.made_elsewhere
    return ", ".join([*parts, made["summary"] if made else f"trained in {duration(record.seconds['train'])}"])
