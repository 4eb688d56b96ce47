"""One cell per GPU: the process that comes first holds it; the next one takes the next GPU, or waits."""

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

LOCKS = Path(tempfile.gettempdir()) / "tdgbench-gpus"  # for all results folders of a machine
ASK_AGAIN_SECONDS = 0.5


@contextlib.contextmanager
def a_gpu_of_its_own(gpus: list[str], locks: Path = LOCKS) -> Iterator[int]:
    """The index of one of the `gpus` (by identity), held until the end; waits while other processes hold all of them.

    The system lets go of it when its holder ends, however that happens.
    """
    while True:
        for index, gpu in enumerate(gpus):
            with file_lock(locks / f"{gpu}.lock") as mine:
                if mine:
                    yield index
                    return
        time.sleep(ASK_AGAIN_SECONDS)


def visible_gpus() -> list[str]:
    """The identities of the GPUs that this process may use, in CUDA's order."""
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
    """The driver's version, as its own tool tells it."""
    command = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
        return said.splitlines()[0].strip() if said.strip() else None
    return None
