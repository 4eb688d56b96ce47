"""Progress of a download: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.filesize import decimal
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from tdgbench.terminal import console, say
from tdgbench.text import one_line

STEP = 10  # percent between two plain lines
SHORTEST_SECONDS, LONGEST_SECONDS = 5.0, 60.0  # between two plain lines


def amount(count: int | None, unit: str = "bytes") -> str:
    """A number of bytes or files in words.

    >>> amount(819_000_000), amount(3, "files"), amount(None)
    ('819.0 MB', '3 files', 'unknown size')
    """
    if count is None:
        return "unknown size"
    return decimal(count) if unit == "bytes" else f"{count} {unit}"


class Meter:
    """Shows how much of one thing is done. Made by `meter`.

    total: None if it is not known. Where there is no terminal, a line comes at steps of 10 %, but not within 5 seconds,
    and after a minute without one.
    """

    def __init__(self, title: str, total: int | None, unit: str, out: Console) -> None:
        self.title, self.total, self.unit = one_line(title), total, unit
        self._begin = self._shown_at = time.monotonic()
        self._first: int | None = None
        self._shown = self._done = 0
        self._bar = Progress(
            TextColumn("{task.description}", markup=False), BarColumn(bar_width=20), TextColumn("{task.fields[state]}"),
            TimeRemainingColumn(), console=out, transient=True, disable=not out.is_terminal,
        )  # fmt: skip
        self._is_bar = out.is_terminal
        self._task = self._bar.add_task(self.title, total=total, state="")

    def add(self, count: int) -> None:
        """Show that `count` more are done."""
        self(self._done + count)

    def __call__(self, done: int) -> None:
        """Show that `done` of `total` are done."""
        self._done = done
        if self._first is None or done < self._first:
            self._first = self._shown = done
        state = f"{amount(done, self.unit)} of {amount(self.total, self.unit)}"
        elapsed = time.monotonic() - self._begin
        if self.unit == "bytes" and elapsed > 0:
            state += f", {decimal(int((done - self._first) / elapsed))}/s"
        if self._is_bar:
            self._bar.update(self._task, completed=done, state=state)
        elif self._is_due(done):
            self._shown, self._shown_at = done, time.monotonic()
            say(f"{self.title}: {self._percent(done)}{state}")

    def _is_due(self, done: int) -> bool:
        waited = time.monotonic() - self._shown_at
        is_step = self.total is not None and 100 * (done - self._shown) >= STEP * self.total
        return done != self.total and (waited >= LONGEST_SECONDS or (is_step and waited >= SHORTEST_SECONDS))

    def _percent(self, done: int) -> str:
        return f"{100 * done // self.total} %, " if self.total else ""

    def start(self) -> None:
        """Show the bar."""
        self._bar.start()

    def stop(self) -> None:
        """Remove the bar."""
        self._bar.stop()


@contextmanager
def meter(title: str, total: int | None, unit: str = "bytes") -> Iterator[Meter]:
    """A meter on standard output while something is done."""
    one = Meter(title, total, unit, console())
    one.start()
    try:
        yield one
    finally:
        one.stop()
