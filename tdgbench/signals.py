"""Ctrl-C and SIGTERM end a run in one line. Nothing heavy is imported here, so that they do so from its start on."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from types import FrameType
from typing import Any

from tdgbench.terminal import say

SIGNALS = (signal.SIGINT, signal.SIGTERM)
WATCH_SECONDS = 1.0  # between two looks at the parent
REPEAT_SECONDS = 5.0  # a library may swallow the exception, e.g. in a destructor; then it is raised again


class Interrupted(KeyboardInterrupt):
    """A signal asks the run to end."""


class Interruption:
    """The signal that asked the run to end, if one did."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.before = {
            number: signal.getsignal(number) for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN
        }
        self._has_begun = False

    @property
    def status(self) -> int:
        """Exit status that names the signal: 130 for Ctrl-C, 143 for SIGTERM."""
        return 128 + (self.signal or 0)

    def begin(self) -> None:
        """Call once everything is imported: from now on a signal raises Interrupted.

        Until then it ends the process: imports turn exceptions into others, and there is nothing to lose. pycolmap's
        import replaces the handlers by glog's, which end the process with a stack trace on SIGTERM.
        """
        import pycolmap  # noqa: F401 (now, and not later)

        self._has_begun = True
        self.handle()

    def handle(self) -> None:
        """Handle the signals, unless the process was started with them ignored."""
        _set(dict.fromkeys(self.before, self._interrupt))

    def end(self) -> None:
        """Stop repeating; without a signal, restore the handlers. After one, the next ends the process at once."""
        if self.signal is None:
            _set(self.before)
        else:
            signal.setitimer(signal.ITIMER_REAL, 0)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.signal = signal.Signals(number)
        _set(dict.fromkeys(self.before, signal.SIG_DFL))
        if not self._has_begun:
            say(f"interrupted by {self.signal.name}", stderr=True)
            os._exit(self.status)
        sys.unraisablehook = _report_unraisable
        signal.signal(signal.SIGALRM, self._repeat)
        signal.setitimer(signal.ITIMER_REAL, REPEAT_SECONDS, REPEAT_SECONDS)
        raise Interrupted(self.signal.name)

    def _repeat(self, number: int, frame: FrameType | None) -> None:
        raise Interrupted(self.signal.name if self.signal else "")


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Return a context in which the first SIGINT or SIGTERM ends the work, and a second one the process at once."""
    interruption = Interruption()
    interruption.handle()
    try:
        yield interruption
    finally:
        interruption.end()


@cache
def end_with_parent() -> None:
    """Make a worker of a process pool, as joblib's, end with the process that started it, even if that is killed.

    Without it, the worker would train on, and hold the lock of its cell. SIGTERM ends it without a stack trace. In
    other processes this does nothing.
    """
    parent = multiprocessing.parent_process()
    if parent is None or parent.pid is None:
        return
    import pycolmap  # noqa: F401 (its import replaces the handlers, see `Interruption.begin`)

    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    watch(parent.pid, lambda: os._exit(128 + signal.SIGKILL))


def watch(parent: int, end: Callable[[], object]) -> None:
    """Call a function, in a thread, once the process `parent` is no longer the parent of this one."""

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_SECONDS)
        end()

    threading.Thread(target=look, name="parent", daemon=True).start()


def _report_unraisable(given: Any) -> None:
    """Report an exception in a destructor, unless a signal raised it there: it will be raised again elsewhere."""
    if not isinstance(given.exc_value, Interrupted):
        sys.__unraisablehook__(given)


def _set(handlers: Mapping[signal.Signals, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)
