"""Threads that run the kernels: plain Python threads, since the kernels release the GIL.

Callers cut work into pieces whose results do not depend on their number, so no result depends on the threads.

An exception of a signal handler (Ctrl-C) may be raised between any two instructions of the main thread. The locks of
`concurrent.futures` and `threading` do not stand that: one stays held for good, or is released twice. So calls are
handed over through `SimpleQueue`, whose operations happen whole or not at all, and waiting ends by what is there.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

import numpy as np

VALUES_EACH, ROWS_EACH = 32_768, 65_536  # of an image, of Gaussians: worth a thread, which takes some 75 µs to wake
WAKE_SECONDS = 0.1  # between looks at the calls, where the message that one has ended was lost to an interruption

_threads: int | None = None
_calls: SimpleQueue[_Call] = SimpleQueue()  # those that no worker has taken
_workers = 0


@functools.cache
def available_cores() -> int:
    """Return on how many cores this process may run when it first asks: by its affinity and a container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.ceil(min(cores, quota())))


def quota(cgroup: Path = Path("/sys/fs/cgroup")) -> float:
    """Return how many cores a container may use at a time (`docker --cpus`); infinity where nothing says so."""
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):  # of cgroups v2 and v1
        with suppress(OSError, ValueError, ZeroDivisionError):
            limit, period = " ".join((cgroup / name).read_text(encoding="ascii") for name in names).split()
            if limit not in ("max", "-1"):
                return int(limit) / int(period)
    return math.inf


def get_threads() -> int:
    """Return the number of threads of the CPU kernels: that given to `set_threads`, else every available core."""
    return _threads if _threads is not None else available_cores()


def set_threads(count: int | None) -> None:
    """Set the number of threads of the CPU kernels (None: every available core)."""
    global _threads
    if count is not None and count < 1:
        raise ValueError(f"threads is {count}; it must be 1 or more")
    _threads = count


def threads_for(items: int, each: int) -> int:
    """Return how many threads some items are worth; one with less than `each` costs more time than it takes over."""
    return max(1, min(get_threads(), items // each))


def run(
    function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], *, items: int | None = None, each: int = 1
) -> list[Any]:
    """Call `function` concurrently, once per tuple of arguments; the calling thread takes the first.

    items, each: how much work all calls are, where it may be too little for a second thread; see `threads_for`. Returns
    the results in order once all calls have ended, or raises the exception of one of them.
    """
    if len(arguments) == 1 or (items is not None and threads_for(items, each) == 1):
        return [function(*call) for call in arguments]
    _start_workers(len(arguments) - 1)
    ended: SimpleQueue[None] = SimpleQueue()
    calls = [_Call(function, rest, ended) for rest in arguments[1:]]
    for call in calls:
        _calls.put(call)
    try:
        first = function(*arguments[0])
    finally:
        _wait(calls, ended)  # they use the caller's arrays
    for call in calls:
        if call.error is not None:
            raise call.error
    return [first, *(call.result for call in calls)]


def run_bands(function: Callable[..., Any], rows: int, image: np.ndarray, *arguments: Any) -> None:
    """Call `function(start, stop, image, *arguments)` concurrently on bands of rows, one for each thread."""
    threads = min(rows, threads_for(image.size, VALUES_EACH))
    run(function, [(*band, image, *arguments) for band in chunks(rows, threads)])


def chunks(count: int, threads: int) -> list[tuple[int, int]]:
    """Cut range(count) into `threads` contiguous pieces (start, stop) of nearly equal length.

    >>> chunks(10, 3)
    [(0, 3), (3, 6), (6, 10)]
    """
    return [(count * t // threads, count * (t + 1) // threads) for t in range(threads)]


class _Call:
    """A call of a worker, and how it ended."""

    def __init__(self, function: Callable[..., Any], arguments: tuple[Any, ...], ended: SimpleQueue[None]) -> None:
        self.function, self.arguments, self.ended = function, arguments, ended
        self.result: Any = None
        self.error: BaseException | None = None
        self.has_ended = False

    def run(self) -> None:
        try:
            self.result = self.function(*self.arguments)
        except BaseException as error:
            self.error = error
        self.has_ended = True
        self.ended.put(None)


def _wait(calls: Sequence[_Call], ended: SimpleQueue[None]) -> None:
    while not all(call.has_ended for call in calls):
        try:
            ended.get(timeout=WAKE_SECONDS)
        except Empty:
            continue


def _start_workers(count: int) -> None:
    """Start workers until there are `count`. They are daemons: the process ends without them."""
    global _workers
    while _workers < count:
        Thread(target=_work, args=(_calls,), name="tdgbench", daemon=True).start()
        _workers += 1


def _work(calls: SimpleQueue[_Call]) -> None:
    while True:
        calls.get().run()


def _forget_workers() -> None:
    """A forked child has none of its parent's threads."""
    global _calls, _workers
    _calls, _workers = SimpleQueue(), 0


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_workers)
