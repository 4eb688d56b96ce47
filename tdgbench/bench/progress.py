"""What a cell is doing: stage, loss, PSNR, Gaussians, time left. A bar on a terminal, a few lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from tdgbench.text import duration, one_line
from tdgbench.training.loop import LogLine

INTERVAL = 60.0  # least number of seconds between two lines on one cell


class CellProgress:
    """One cell after the other: `begin`, then the other calls, then `end`.

    On a terminal, a bar that is gone at the end. Elsewhere (a file, a pipe, SLURM's log) plain lines, each of which
    names its cell, since several processes may print to one file: one at the start, then at most one a minute.

    clock: seconds, for the lines.
    """

    def __init__(self, console: Console, iterations: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._view = _Bar(console, iterations) if console.is_interactive else _Lines(console, iterations, clock)

    def begin(self, title: str) -> None:
        """Begin a cell, which may turn out to be finished already."""
        self._view.begin(title)

    def rename(self, title: str) -> None:
        """Change the title of the cell."""
        self._view.rename(title)

    def start(self, views: int) -> None:
        """The cell has to run: it trains on so many views."""
        self._view.start(views)

    def stage(self, name: str) -> None:
        """Begin a stage."""
        self._view.stage(name)

    def count(self, done: int, total: int) -> None:
        """Show how many of a stage's views are done."""
        self._view.count(done, total)

    def line(self, line: LogLine) -> None:
        """Show a line of the training log."""
        self._view.line(line)

    def end(self) -> None:
        """End the cell."""
        self._view.end()


class _Bar:
    """A bar with the state of the cell beside it."""

    def __init__(self, console: Console, iterations: int) -> None:
        self.console, self.iterations = console, iterations
        self._show("")

    def begin(self, title: str) -> None:
        self._show(title)
        self._progress.start()

    def rename(self, title: str) -> None:
        self._progress.update(self._task, description=title)

    def start(self, views: int) -> None:
        pass

    def stage(self, name: str) -> None:
        if name == "train":
            self._progress.reset(self._task, total=self.iterations)
        self._progress.update(self._task, state=name)

    def count(self, done: int, total: int) -> None:
        self._progress.update(self._task, completed=done, total=total)

    def line(self, line: LogLine) -> None:
        self._progress.update(self._task, completed=line.iteration, state=_numbers(line, "  "))

    def end(self) -> None:
        self._progress.stop()

    def _show(self, title: str) -> None:
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:>3.0f}%"),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            transient=True,
        )
        self._task = self._progress.add_task(title, total=None, state="")


class _Lines:
    """Plain lines. The time left is that at the pace since the line before."""

    def __init__(self, console: Console, iterations: int, clock: Callable[[], float]) -> None:
        self.console, self.iterations, self.clock = console, iterations, clock
        self.begin("")

    def begin(self, title: str) -> None:
        self._title, self._stage = title, ""
        self._last = self.clock()  # time of the last line
        self._mark: tuple[float, int] | None = None  # time and count from which the pace is measured

    def rename(self, title: str) -> None:
        self._title = title

    def start(self, views: int) -> None:
        self._print(f"starts, {self.iterations} iterations on {views} training views")

    def stage(self, name: str) -> None:
        self._stage, self._mark = name, None
        if self._is_due():
            self._print(f"stage {name}")

    def count(self, done: int, total: int) -> None:
        self._report(done, total, f"{self._stage}, {done} of {total} views")

    def line(self, line: LogLine) -> None:
        state = f"iteration {line.iteration} of {self.iterations}, {_numbers(line, ', ')}"
        self._report(line.iteration, self.iterations, state)

    def end(self) -> None:
        pass

    def _report(self, done: int, total: int, state: str) -> None:
        """Print what the stage has done, if a line is due."""
        now = self.clock()
        if self._is_due():
            self._print(state + self._left(now, done, total))
            self._mark = now, done
        self._mark = self._mark or (now, done)

    def _left(self, now: float, done: int, total: int) -> str:
        if self._mark is None or done <= self._mark[1]:
            return ""
        then, before = self._mark
        return f", about {duration((total - done) * (now - then) / (done - before))} left"

    def _is_due(self) -> bool:
        return self.clock() - self._last >= INTERVAL

    def _print(self, state: str) -> None:
        self._last = self.clock()
        self.console.print(Text(one_line(f"{self._title}: {state}")), soft_wrap=True)


def _numbers(line: LogLine, between: str) -> str:
    """State of a training in words."""
    return between.join((f"loss {line.loss:.4f}", f"PSNR {line.psnr:.1f} dB", f"{line.gaussians:,} Gaussians"))
