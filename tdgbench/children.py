"""Processes with a time limit, that end with everything that they started."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple


class Ended(NamedTuple):
    """A process that has ended."""

    status: int | None  # exit status; below 0: minus the signal that ended it; None: the time limit did
    out: str  # its standard output
    errors: str  # its standard error

    @property
    def why(self) -> str:
        """How it ended, in a few words: its status, and the last line of its errors."""
        if self.status is None:
            return "it did not end within its time limit"
        how = f"signal {signal.Signals(-self.status).name}" if self.status < 0 else f"status {self.status}"
        last = (self.errors.strip().splitlines() or [""])[-1]
        return f"it ended by {how}{': ' * bool(last)}{last}"


def with_path(folder: Path) -> dict[str, str]:
    """Return this process's environment, in which Python looks for modules in a folder first."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))}


def run_limited(command: Sequence[str], seconds: float, folder: Path) -> Ended:
    """Run a command in a folder. When it ends, after so many seconds, or if interrupted, its group is killed."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        child = subprocess.Popen(command, stdout=out, stderr=errors, cwd=folder, start_new_session=True)
        status = None
        try:
            status = child.wait(seconds)
        except subprocess.TimeoutExpired:
            pass
        finally:
            with suppress(ProcessLookupError):  # what it started may live on when it has ended
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        texts = []
        for file in (out, errors):
            file.seek(0)
            texts.append(file.read().decode(errors="replace"))
    return Ended(status, *texts)
