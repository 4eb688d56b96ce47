"""Locks that keep two processes from running the same cell."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from tdgbench.cells.paths import short_name


def cell_lock(experiment: Path, folder: Path) -> AbstractContextManager[bool]:
    """Return a context that tries to lock the cell of `folder`, and tells whether it worked.

    The system releases a lock when its process ends, for whatever reason. Lock files are never removed: that would let
    a process that waits for the old file and one that makes a new file hold the lock at the same time.
    """
    return file_lock(experiment / "locks" / f"{short_name(experiment, folder)}.lock")


@contextmanager
def file_lock(path: Path) -> Iterator[bool]:
    """Try to lock a file; yield False at once if another process holds it.

    Raises OSError, with the path and the remedy, if the file cannot be made.
    """
    lock = FileLock(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        yield False
        return
    except OSError as error:
        what = f"{error.strerror or error}: no lock can be made here; remove what is in its place, or make it writable"
        raise OSError(error.errno, what, str(error.filename or path)) from error
    try:
        yield True
    finally:
        lock.release()
