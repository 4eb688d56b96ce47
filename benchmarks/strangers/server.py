"""A process that has imported the tools once, and runs each command in a forked child, limited and watched.

`python -m benchmarks.strangers.server` reads a request per line, JSON, and answers with a line; `Server` is its client.
It starts no threads before it forks: children would not have them.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import select
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.strangers.watch import ROOT, limit, settle, watch
from tdgbench.children import with_path

GB = 2**30
SECONDS = 20.0  # that a case may take
MOST_BYTES = GB  # of memory beyond that of the server
MOST_FILE = 2 * GB
TAIL = 6000  # characters of the output that are kept
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": "", "COLUMNS": "200",
               "PYTHONHASHSEED": "0"}  # fmt: skip


@dataclass
class Outcome:
    """How a command ended. status: None if a signal ended it. mb: of memory beyond the server's at most.

    written_mb: by it in all. error: traceback of an exception that the program does not expect.
    """

    status: Any = None
    signal: int = 0
    seconds: float = 0.0
    timed_out: bool = False
    mb: float = 0.0
    written_mb: float = 0.0
    violations: list[str] = field(default_factory=list)
    error: str = ""
    output: str = ""  # the end of it
    printed: int = 0  # characters


class Server:
    """The server process, to be used in a `with` statement. patience: × SECONDS, where other work shares the cores."""

    def __init__(self, patience: float = 1.0) -> None:
        self._seconds = patience * SECONDS

    def __enter__(self) -> Server:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__], cwd=ROOT, env={**with_path(ROOT), **ENVIRONMENT},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def run(self, words: list[str], folder: Path, how: str = "watched", seconds: float | None = None) -> Outcome:
        """Run `tdgbench WORDS` in a folder. how: `watched`; `trusted`, without limits; `warm`, in the server itself.

        The latter imports the modules and loads the kernels that later commands need. A first word `module:function` is
        a function that is called with the other words.
        """
        assert self._process.stdin is not None and self._process.stdout is not None
        request = {"words": words, "folder": str(folder), "how": how, "seconds": seconds or self._seconds}
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the server has ended with status {self._process.wait()}")
        return Outcome(**json.loads(answer))


def serve() -> None:
    """Import what tools need, then answer requests."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    import tdgbench.experiments.experiment  # noqa: F401 (what tools need)
    from tdgbench.splats.cpu import pool
    from tdgbench.tools import TOOLS

    for module in ("benchmarks.strangers.checkpoints", *(tool.module for tool in TOOLS.values())):
        importlib.import_module(module)
    pool.set_threads(1)
    for line in sys.stdin:
        request = json.loads(line)
        words, folder = request["words"], Path(request["folder"])
        if request["how"] == "warm":
            settle(folder)
            outcome = Outcome(status=_callable(words)())
        else:
            outcome = _run_in_child(words, folder, request["seconds"] if request["how"] == "watched" else None)
        print(json.dumps(asdict(outcome)), file=answers, flush=True)


def _run_in_child(words: list[str], folder: Path, most_seconds: float | None) -> Outcome:
    """Fork, run, and say how it ended. most_seconds: None for a run that is neither limited nor watched."""
    report, output = (folder.with_name(f".{folder.name}.{name}") for name in ("report", "output"))
    begin = time.monotonic()
    child = os.fork()
    if child == 0:
        _be_child(words, folder, most_seconds is not None, report, output)
    ended = os.pidfd_open(child)
    timed_out = not select.select([ended], [], [], most_seconds)[0]
    os.close(ended)
    seconds = time.monotonic() - begin
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    found = json.loads(report.read_text(encoding="utf-8")) if report.exists() else {}
    said = output.read_bytes().decode("utf-8", "replace") if output.exists() else ""
    for path in (report, output):
        path.unlink(missing_ok=True)
    ended_by = os.WTERMSIG(status) if os.WIFSIGNALED(status) and "status" not in found else 0
    mb = max(0.0, usage.ru_maxrss / 1024 - found.pop("began_with_mb", 0.0))
    found |= {"signal": ended_by, "seconds": round(seconds, 3), "timed_out": timed_out, "mb": round(mb, 1)}
    return Outcome(output=said[-TAIL:], printed=len(said), **found)


def _be_child(words: list[str], folder: Path, is_watched: bool, report: Path, output: Path) -> None:
    """Run a command and end the process."""
    os.setsid()
    for number, path in ((0, "/dev/null"), (1, output), (2, output)):
        os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600), number)
    found: dict[str, Any] = {"violations": [], "began_with_mb": _resident_mb()}
    descriptor = os.open(report, os.O_WRONLY | os.O_CREAT, 0o600)

    def write() -> None:
        os.pwrite(descriptor, json.dumps(found).encode(), 0)  # it only grows

    def note(what: str) -> None:
        found["violations"].append(what)
        write()

    write()
    stop: Callable[[], None] = write
    try:
        call = _callable(words)
        if is_watched:
            limit(MOST_BYTES, MOST_FILE, int(2 * SECONDS))
            stop = watch(folder, note)
        settle(folder)
        found["status"] = call()
    except SystemExit as end:
        found["status"] = end.code
    except BaseException as error:
        stop()
        found["status"] = 1
        from tdgbench.bench.failures import EXPECTED_ERRORS

        print(f"error: {error}", file=sys.stderr)
        if not isinstance(error, (OSError, *EXPECTED_ERRORS)):
            found["error"] = traceback.format_exc()[-TAIL:]
    finally:
        stop()
        sys.stdout.flush()
        sys.stderr.flush()
        with open("/proc/self/io", encoding="ascii") as file:  # noqa: PTH123
            written = next(int(line.split()[1]) for line in file if line.startswith("wchar"))
        found["written_mb"] = round(written / 2**20, 1)
        write()
        os._exit(0)


def _callable(words: list[str]) -> Callable[[], Any]:
    """Return what runs a command, once all that it needs is imported."""
    if ":" in words[0]:
        module, _, name = words[0].partition(":")
        return partial(getattr(importlib.import_module(module), name), words[1:])
    from tdgbench.__main__ import main
    from tdgbench.terminal import FULL_ERROR

    sys.argv[:], os.environ[FULL_ERROR] = ["tdgbench", *words], "1"
    return main


def _resident_mb() -> float:
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    serve()
