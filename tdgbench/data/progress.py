"""Progress of a step: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.filesize import decimal
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

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
        done = (DownloadColumn(), TransferSpeedColumn()) if is_bytes else (MofNCompleteColumn(),)
        columns = TextColumn("{task.description}", markup=False), BarColumn(bar_width=30), *done
        with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=screen) as bar:
            task = bar.add_task(name, total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    say(f"{name}: {amount(total) if is_bytes else total}")
    yield lambda done: None
    say(f"{name}: done in {time.perf_counter() - start:.0f} s")
