"""Two processes on the same results never run the same cell: the one that comes first holds its lock."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from tdgbench.bench.output import short_name


@contextmanager
def cell_lock(experiment: Path, folder: Path) -> Iterator[bool]:
    """True while this process alone holds the cell that belongs in `folder`; False if another one does.

    The system lets go of a lock when its process ends, however that happens. Lock files stay where they are:
    removing one while another process waits for it would give both of them the lock.
    """
    with file_lock(experiment / "locks" / f"{short_name(experiment, folder)}.lock") as mine:
        yield mine


@contextmanager
def file_lock(path: Path) -> Iterator[bool]:
    """True while this process alone holds the lock of a file; False if another one does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()
