"""One cell per GPU: a process locks a free GPU, or waits for one."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import torch

from tdgbench.bench.lock import file_lock

LOCKS = Path(tempfile.gettempdir()) / "tdgbench-gpus"  # shared by all results folders of a machine
RETRY_SECONDS = 0.5


@contextlib.contextmanager
def exclusive_gpu(gpus: list[str], locks: Path = LOCKS) -> Iterator[int]:
    """Lock one of the `gpus` (UUIDs) and yield its index; wait while other processes hold all of them.

    The system releases the lock when its process ends, for whatever reason.
    """
    while True:
        for index, gpu in enumerate(gpus):
            with file_lock(locks / f"{gpu}.lock") as acquired:
                if acquired:
                    yield index
                    return
        time.sleep(RETRY_SECONDS)


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
