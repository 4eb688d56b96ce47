"""Check a GPU's backend in a process of its own: a compiler that hangs, or a driver that crashes, costs the backend."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict

from tdgbench.bench.backend_check.check import BackendCheck, check
from tdgbench.children import run_limited
from tdgbench.resources import PACKAGE
from tdgbench.text import shortened

LIMIT_SECONDS = 3600.0  # gsplat compiles for minutes, on two slow cores for half an hour


def check_apart(
    backend: str, device: int, command: Sequence[str] | None = None, limit: float = LIMIT_SECONDS
) -> BackendCheck:
    """Check a backend on a CUDA device (its index) in a new process; what ends that is a reason to refuse the backend.

    After `limit` seconds, it is killed with the compilers that it started. command: stands in for the check in tests.
    """
    ended = run_limited(command or [sys.executable, "-m", __name__, backend, str(device)], limit, PACKAGE.parent)
    if ended.status == 0:
        with suppress(ValueError, TypeError, IndexError):
            return BackendCheck(**json.loads(ended.out.strip().splitlines()[-1]))
    limited = f" of {limit:g} s" if ended.status is None else ""
    return BackendCheck(shortened(f"its check failed: {ended.why}{limited}"), runs=False)


def main() -> None:
    """Check the backend that the first argument names on the device of the second; write the outcome as JSON."""
    import torch

    with torch.cuda.device(int(sys.argv[2])):
        sys.stdout.write(json.dumps(asdict(check(sys.argv[1]))) + "\n")


if __name__ == "__main__":
    main()
