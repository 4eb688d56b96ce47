"""Progress of the steps: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from tdgbench.terminal import console, say

QUIET_SECONDS = 60.0  # between two lines of a step where there is no terminal

Count = Callable[[int], None]


@contextmanager
def step(name: str, total: int) -> Iterator[Count]:
    """Context of a step; yields a function that takes how many of `total` are done.

    Without a terminal, one line says that the step begins, then one a minute how far it is, and one that it is done.
    """
    screen = console()
    if screen.is_terminal:
        columns = TextColumn("{task.description}", markup=False), BarColumn(bar_width=30), MofNCompleteColumn()
        with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=screen) as bar:
            task = bar.add_task(name, total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    start = last = time.perf_counter()
    say(f"{name}: {total}")

    def count(done: int) -> None:
        nonlocal last
        now = time.perf_counter()
        if now - last >= QUIET_SECONDS:
            say(f"{name}: {done} of {total} after {now - start:.0f} s")
            last = now

    yield count
    say(f"{name}: done in {time.perf_counter() - start:.0f} s")
