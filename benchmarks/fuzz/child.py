"""Run a function in a forked child with limits of time and memory; its output goes to files. Linux only.

The parent has imported everything, so a child starts in milliseconds. It must not have threads of its own.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from tdgbench.terminal import say

OUTPUT = "output.txt"  # what a child printed, in its folder
MB = 2**20
PR_SET_PDEATHSIG = 1  # of Linux's prctl
SPARE = 6144  # MB of private memory above the limit, which may be reserved without being used


class Limits(NamedTuple):
    """Wall time, and resident memory of a child and its descendants."""

    seconds: float = 20.0
    megabytes: int = 3072


@dataclass(frozen=True)
class Ran:
    """How a child ended. status: None where a signal or a limit ended it. megabytes: peak of resident memory."""

    ending: Literal["ended", "signal", "hang", "memory"]
    status: int | None
    seconds: float
    megabytes: float
    output: str


class Child:
    """A running child; its working folder is `folder`."""

    def __init__(self, work: Callable[[], int | str | None], folder: Path, limits: Limits) -> None:
        self.folder, self.limits, self.start, self.peak = folder, limits, time.monotonic(), 0.0
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if self.pid == 0:
            _be_the_child(work, folder, limits)

    def poll(self) -> Ran | None:
        """The end of the child; None while it runs. A child over its limits is killed."""
        pid, state, usage = os.wait4(self.pid, os.WNOHANG)
        seconds = time.monotonic() - self.start
        ending: Literal["signal", "hang", "memory"] = "signal"
        if pid == 0:
            self.peak = max(self.peak, tree_megabytes(self.pid))
            if self.peak <= self.limits.megabytes and seconds <= self.limits.seconds:
                return None
            ending = "memory" if self.peak > self.limits.megabytes else "hang"
            _kill_group(self.pid)
            _, state, usage = os.wait4(self.pid, 0)
        _kill_group(self.pid)  # descendants that outlived it
        status = os.waitstatus_to_exitcode(state)
        output = (self.folder / OUTPUT).read_text(encoding="utf-8", errors="replace")
        peak = max(self.peak, usage.ru_maxrss / 1024)
        if ending == "signal" and status >= 0:
            return Ran("ended", status, seconds, peak, output)
        return Ran(ending, None, seconds, peak, output)


def _be_the_child(work: Callable[[], int | str | None], folder: Path, limits: Limits) -> None:
    """Do the work as a process of its own would: the exit status, the traceback of an exception. Never returns."""
    status = 1
    try:
        os.setsid()
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # end with the suite, however it ends
        faulthandler.disable()  # a crash is judged by its signal
        os.chdir(folder)
        out = os.open(OUTPUT, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for descriptor, source in ((0, os.open(os.devnull, os.O_RDONLY)), (1, out), (2, out)):
            os.dup2(source, descriptor)
        sys.stdin, sys.stdout, sys.stderr = (os.fdopen(os.dup(i), m) for i, m in ((0, "r"), (1, "w"), (2, "w")))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL if number != signal.SIGINT else signal.default_int_handler)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        most = (limits.megabytes + SPARE) * MB
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        status = _status_of(work)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)


def _status_of(work: Callable[[], int | str | None]) -> int:
    try:
        code = work()
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        return 1
    if isinstance(code, str):
        say(code, stderr=True)
    return code if isinstance(code, int) else int(code is not None)


def tree_megabytes(pid: int) -> float:
    """Resident memory of a process and its descendants."""
    total, pending = 0, [pid]
    while pending:
        process = Path("/proc", str(pending.pop()))
        try:
            total += int((process / "statm").read_text(encoding="utf-8").split()[1])
            pending += [
                int(p) for p in (process / "task" / process.name / "children").read_text(encoding="utf-8").split()
            ]
        except (OSError, IndexError):
            continue  # it ended meanwhile
    return total * resource.getpagesize() / MB


def _kill_group(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
