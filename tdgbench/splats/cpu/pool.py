"""Thread pool that runs the kernels: plain Python threads, since the kernels release the GIL.

Callers cut work into pieces whose results do not depend on their number, so no result depends on the threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

_threads: int | None = None
_pool: tuple[int, int, ThreadPoolExecutor] | None = None  # process id, workers, pool


def available_cores() -> int:
    """Cores that this process may run on, by its affinity where the platform reports it."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def get_threads() -> int:
    """Threads of the CPU kernels: the number given to `set_threads`, else every available core."""
    return _threads if _threads is not None else available_cores()


def chosen_threads() -> int | None:
    """Number given to `set_threads`; None means every available core."""
    return _threads


def set_threads(count: int | None) -> None:
    """Set the number of threads of the CPU kernels (None: every available core)."""
    global _threads
    if count is not None and count < 1:
        raise ValueError(f"threads is {count}; it must be 1 or more")
    _threads = count


def run(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Call `function` concurrently, once per tuple of arguments; the calling thread takes the first.

    Returns the results in order once all calls have ended, or raises the exception of one of them.
    """
    if len(arguments) == 1:
        return [function(*arguments[0])]
    futures = [_executor(len(arguments) - 1).submit(function, *rest) for rest in arguments[1:]]
    try:
        return [function(*arguments[0]), *(future.result() for future in futures)]
    except BaseException:
        wait(futures)  # they use the caller's arrays
        raise


def chunks(count: int, threads: int) -> list[tuple[int, int]]:
    """Cut range(count) into `threads` contiguous pieces (start, stop) of nearly equal length.

    >>> chunks(10, 3)
    [(0, 3), (3, 6), (6, 10)]
    """
    return [(count * t // threads, count * (t + 1) // threads) for t in range(threads)]


def _executor(workers: int) -> ThreadPoolExecutor:
    """Pool of this process with at least so many workers; a forked child cannot use its parent's threads."""
    global _pool
    if _pool is None or _pool[0] != os.getpid() or _pool[1] < workers:
        _pool = (os.getpid(), workers, ThreadPoolExecutor(workers, thread_name_prefix="tdgbench"))
    return _pool[2]
