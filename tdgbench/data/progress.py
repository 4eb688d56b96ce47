"""Progress of a step: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich import progress
from rich.filesize import decimal

from tdgbench.terminal import console, say
from tdgbench.text import one_line

Count = Callable[[int], None]


def amount(size: int | None) -> str:
    """Return a number of bytes in words.

    >>> amount(819_000_000), amount(None)
    ('819.0 MB', 'unknown size')
    """
    return "unknown size" if size is None else decimal(size)


@contextmanager
def step(name: str, total: int | None, is_bytes: bool = False) -> Iterator[Count]:
    """Show the progress of a step; yield a function that takes how many of `total` (None: unknown) are done.

    Without a terminal, one line says that the step begins, and one that it is done.
    """
    name, screen, start = one_line(name), console(), time.perf_counter()
    if screen.is_terminal:
        of_bytes = progress.DownloadColumn(), progress.TransferSpeedColumn()
        done = of_bytes if is_bytes else (progress.MofNCompleteColumn(),)
        times = progress.TimeElapsedColumn(), progress.TimeRemainingColumn()
        columns = progress.TextColumn("{task.description}", markup=False), progress.BarColumn(bar_width=30), *done
        with progress.Progress(*columns, *times, console=screen) as bar:
            task = bar.add_task(name, total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    say(f"{name}: {amount(total) if is_bytes else total}")
    yield lambda done: None
    say(f"{name}: done in {time.perf_counter() - start:.0f} s")
