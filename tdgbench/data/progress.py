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

QUIET_SECONDS = 60.0  # between two lines of a step where there is no terminal

Count = Callable[[int], None]


def amount(size: int | None) -> str:
    """Return A number of bytes in words.

    >>> amount(819_000_000), amount(None)
    ('819.0 MB', 'unknown size')
    """
    return "unknown size" if size is None else decimal(size)


@contextmanager
def step(name: str, total: int | None, is_bytes: bool = False) -> Iterator[Count]:
    """Context of a step; yields a function that takes how many of `total` (None: not known) are done.

    Without a terminal, one line says that the step begins, then one a minute how far it is, and one that it is done.
    """
    name, in_words = one_line(name), amount if is_bytes else str
    screen = console()
    if screen.is_terminal:
        done = (DownloadColumn(), TransferSpeedColumn()) if is_bytes else (MofNCompleteColumn(),)
        columns = TextColumn("{task.description}", markup=False), BarColumn(bar_width=30), *done
        with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=screen) as bar:
            task = bar.add_task(name, total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    start = last = time.perf_counter()
    say(f"{name}: {in_words(total)}")

    def count(done: int) -> None:
        nonlocal last
        now = time.perf_counter()
        if now - last >= QUIET_SECONDS:
            say(f"{name}: {in_words(done)} of {in_words(total)} after {now - start:.0f} s")
            last = now

    yield count
    say(f"{name}: done in {time.perf_counter() - start:.0f} s")
