"""Progress bar of a cell: stage, iteration, loss, PSNR, number of Gaussians, remaining time."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from tdgbench.training.loop import LogLine


class CellProgress:
    """One line on a terminal, one cell after the other: `begin`, then the other calls, then `end`.

    Where there is no terminal, nothing is printed.
    """

    def __init__(self, console: Console, iterations: int) -> None:
        self.console = console
        self.iterations = iterations
        self._show("")

    def begin(self, title: str) -> None:
        """Show the bar of a cell."""
        self._show(title)
        self._progress.start()

    def rename(self, title: str) -> None:
        """Change the title of the cell."""
        self._progress.update(self._task, description=title)

    def stage(self, name: str) -> None:
        """Begin a stage."""
        if name == "train":
            self._progress.reset(self._task, total=self.iterations)
        self._progress.update(self._task, state=name)

    def count(self, done: int, total: int) -> None:
        """Show how many of a stage's views are done."""
        self._progress.update(self._task, completed=done, total=total)

    def line(self, line: LogLine) -> None:
        """Show a line of the training log."""
        state = f"loss {line.loss:.4f}  PSNR {line.psnr:.1f} dB  {line.gaussians:,} Gaussians"
        self._progress.update(self._task, completed=line.iteration, state=state)

    def end(self) -> None:
        """Remove the bar."""
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
            disable=not self.console.is_terminal,
        )
        self._task = self._progress.add_task(title, total=None, state="")
