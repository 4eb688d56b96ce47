"""The progress bar of a cell: iteration, loss, PSNR so far, Gaussians, time left."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from tdgbench.training.loop import LogLine


class CellProgress:
    """One line on the terminal; where there is no terminal, one line per finished cell."""

    def __init__(self, console: Console, iterations: int) -> None:
        self.console = console
        self.iterations = iterations
        self._progress: Progress | None = None
        self._last = ""

    def begin(self, title: str) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:>3.0f}%"),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            transient=True,
            disable=not self.console.is_terminal,
        )
        self._progress.start()
        self._task = self._progress.add_task(title, total=None, state="")

    def rename(self, title: str) -> None:
        assert self._progress is not None
        self._progress.update(self._task, description=title)

    def stage(self, name: str) -> None:
        assert self._progress is not None
        if name == "train":
            self._progress.reset(self._task, total=self.iterations)
        self._progress.update(self._task, state=name)

    def count(self, done: int, total: int) -> None:
        """Progress of a stage that goes through views."""
        assert self._progress is not None
        self._progress.update(self._task, completed=done, total=total)

    def line(self, line: LogLine) -> None:
        """Progress of training."""
        assert self._progress is not None
        state = f"loss {line.loss:.4f}  PSNR {line.psnr:.1f} dB  {line.gaussians:,} Gaussians"
        self._progress.update(self._task, completed=line.iteration, state=state)

    def end(self) -> None:
        if self._progress is not None:
            self._progress.stop()
            self._progress = None
