"""One cell per GPU: a process locks a free GPU, or waits for one."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import torch

from tdgbench.bench.lock import file_lock

LOCKS = Path(tempfile.gettempdir()) / "tdgbench-gpus"  # shared by all users and results folders of a machine
FOR_ALL = 0o666  # permissions of a lock that other users take as well
RETRY_SECONDS = 0.5


@contextlib.contextmanager
def exclusive_gpu(gpus: list[str], locks: Path = LOCKS) -> Iterator[int]:
    """Lock one of the `gpus` (UUIDs) and yield its index; wait while other processes hold all of them.

    The system releases the lock when its process ends, for whatever reason. Where `locks` cannot be used, a folder of
    this user takes its place, with a warning.
    """
    names = [f"{gpu}.lock" for gpu in gpus]
    problem = _problem(locks, names)
    if problem is not None:
        warnings.warn(f"GPUs are not locked against other users: {problem}", stacklevel=3)
        locks = locks.with_name(f"{locks.name}-{os.getuid()}")
    while True:
        for index, name in enumerate(names):
            with file_lock(locks / name, FOR_ALL) as acquired:
                if acquired:
                    yield index
                    return
        time.sleep(RETRY_SECONDS)


def _problem(locks: Path, names: list[str]) -> OSError | None:
    """Why a folder cannot hold locks of these names, which all users can take; None if it can."""
    try:
        locks.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(PermissionError):
            locks.chmod(0o1777)  # whatever the umask; only its owner may
        for name in names:
            with file_lock(locks / name, FOR_ALL):
                pass
    except OSError as error:
        return error
    return None


def visible_gpus() -> list[str]:
    """UUIDs of the GPUs that this process may use, in CUDA's order."""
    return [str(torch.cuda.get_device_properties(i).uuid) for i in range(torch.cuda.device_count())]


def describe_gpu() -> dict[str, Any] | None:
    """Name, memory, driver and CUDA version of the GPU in use; None without one."""
    if not torch.cuda.is_available():
        return None
    properties = torch.cuda.get_device_properties(torch.cuda.current_device())
    return {
        "name": properties.name,
        "memory_mb": round(properties.total_memory / 2**20),
        "driver": _driver(),
        "cuda": torch.version.cuda,
    }


@cache
def _driver() -> str | None:
    """Version of the NVIDIA driver; None if nvidia-smi does not report it."""
    command = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
        return output.splitlines()[0].strip() if output.strip() else None
    return None
