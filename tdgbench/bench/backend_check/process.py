"""Check a backend in a process of its own: what breaks there, as a CUDA context, does not break the caller.

`python -m tdgbench.bench.backend_check.process BACKEND GPU FILE` writes the verdict to FILE as JSON.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import torch

from tdgbench.bench.backend_check.check import Verdict, check
from tdgbench.bench.backend_check.stored import as_json, verdict_of
from tdgbench.bench.environment import ROOT
from tdgbench.files import write_text
from tdgbench.text import shortened

LONGEST_SECONDS = 900.0  # gsplat's wheel of PyPI compiles its kernels at their first use, for some minutes
COMMAND = (sys.executable, "-m", "tdgbench.bench.backend_check.process")
LONGEST_REASON = 200  # characters of what the process printed last


def check_in_process(
    backend: str, gpu: int, command: tuple[str, ...] = COMMAND, seconds: float = LONGEST_SECONDS
) -> Verdict:
    """Verdict on a backend on a GPU (CUDA's index). A process that ends in another way gives a verdict as well."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryDirectory(prefix="tdgbench-") as folder:
        file = Path(folder) / "verdict.json"
        try:
            run = subprocess.run(
                [*command, backend, str(gpu), str(file)], env={**os.environ, "PYTHONPATH": path},
                stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8", errors="replace", timeout=seconds,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return Verdict(f"its check was ended after {seconds:g} s", is_lasting=False)
        except OSError as error:
            return Verdict(f"its check could not be started ({error.strerror})", is_lasting=False)
        if file.exists():
            return verdict_of(file.read_text(encoding="utf-8"))
    last = (run.stderr.strip().splitlines() or ["nothing was printed"])[-1]
    return Verdict(f"its check ended by {_ending(run.returncode)}: {shortened(last, LONGEST_REASON)}", is_lasting=False)


def _ending(status: int) -> str:
    """How a process ended.

    >>> _ending(1), _ending(-11)
    ('status 1', 'SIGSEGV')
    """
    return signal.Signals(-status).name if -status in set(signal.Signals) else f"status {status}"


def main() -> None:
    """Check the backend that the arguments name and write the verdict."""
    backend, gpu, file = sys.argv[1:]
    if torch.cuda.is_available():
        torch.cuda.set_device(int(gpu))
    write_text(Path(file), as_json(check(backend)))


if __name__ == "__main__":
    main()
