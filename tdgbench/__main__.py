"""`tdgbench` and `python -m tdgbench`: run a command, and turn what ends it early into one line and an exit status."""

from __future__ import annotations

import gc
import os
import signal
import sys
from typing import NoReturn

from tdgbench.resources import import_from_no_working_folder
from tdgbench.signals import SIGNALS, Interrupted, interruptible
from tdgbench.terminal import FULL_ERROR, guard_streams, say


def main() -> int:
    """Run what the command line asks for; return the exit status.

    0: done. 1: something failed. 2: no such tool. 130 and 143: ended by Ctrl-C and SIGTERM.
    """
    if os.name == "nt":
        say("tdgbench runs on Linux and macOS; on Windows, run it in WSL2", "error:", stderr=True)
        return 1
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # NumPy's and SciPy's; on small matrices its threads only wait
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")  # of joblib, about workers that a signal ended
    gc.disable()  # what is imported stays: looking for garbage takes a fifth of an import's time
    guard_streams()
    wants_traceback = bool(os.environ.get(FULL_ERROR))
    try:
        import_from_no_working_folder()
    except OSError as error:  # torch would end the process without a word
        if not {"--version", "--help", "-h"} & set(sys.argv[1:2]):
            say(str(error), "error:", stderr=True)
            return 1
    with interruptible() as interruption:
        try:
            from tdgbench import command

            def on_loaded() -> None:
                interruption.begin()
                gc.freeze()
                gc.enable()

            return command.run(sys.argv[1:], on_loaded)
        except (Exception, Interrupted) as error:
            interruption.end()
            if interruption.signal is not None:
                notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
                say(f"interrupted by {interruption.signal.name}{notes or _kept()}", stderr=True)
                return interruption.status
            if wants_traceback:
                raise
            from tdgbench.bench.failures import error_message

            say(error_message(error, sys.argv[1:]), "error:", stderr=True)
            return 1
        finally:
            gc.enable()


def _kept() -> str:
    """Return what is kept of an interrupted run, if it has begun."""
    callback = getattr(sys.modules.get("tdgbench.experiments.experiment"), "ExperimentCallback", None)
    if callback is None or callback.folder is None:
        return ""
    from tdgbench.bench.run_cell import stored_in_words

    return f"; {stored_in_words(callback.folder)}"


def run() -> NoReturn:
    """Run `main` and end the process. A signal that comes while the interpreter shuts down changes nothing."""
    status = main()
    gc.freeze()  # the interpreter's last collections take a second, and free what the process frees by ending
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    sys.exit(status)


if __name__ == "__main__":
    run()
