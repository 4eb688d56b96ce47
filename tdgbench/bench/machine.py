"""The GPU of a cell, which its process locks, and the cell's peak memory, in RAM and on the GPU."""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import torch

from tdgbench.files import file_lock
from tdgbench.splats.cpu.scratch import free_buffers

LOCKS = Path(tempfile.gettempdir()) / f"tdgbench-gpus-{os.getuid()}"  # of all results folders of this user
RETRY_SECONDS = 0.5
STATUS = Path("/proc/self/status")
SAMPLE_SECONDS = 0.02
ROUNDING_MB = 16.0


@contextlib.contextmanager
def exclusive_gpu(gpus: list[str], locks: Path = LOCKS) -> Iterator[int]:
    """Lock one of the `gpus` (UUIDs) and yield its index; wait while this user's other processes hold all of them.

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
    """Return UUIDs of the GPUs that this process may use, in CUDA's order."""
    return [str(torch.cuda.get_device_properties(i).uuid) for i in range(torch.cuda.device_count())]


def describe_gpu() -> dict[str, Any] | None:
    """Return the name, memory, driver and CUDA version of the GPU in use; None without one."""
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
    """Return the version of the NVIDIA driver; None if nvidia-smi does not report it."""
    return first_line_of("nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader")


def first_line_of(*command: str) -> str | None:
    """Return the first line that a program of the system prints; None if there is none."""
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
        return output.splitlines()[0].strip() if output.strip() else None
    return None


class PeakMemory:
    """Context that measures peak memory. On entry it frees what earlier cells left.

    mb: largest resident size, MB; None where the platform does not report it. gpu_mb: most memory of the current GPU
    that torch reserved, MB; None unless `on_gpu`.

    Linux tracks the peak and lets a process reset it. Where the reset has no effect (some sandboxes), a thread samples
    the current size instead.
    """

    def __init__(self, on_gpu: bool = False) -> None:
        self._on_gpu = on_gpu
        self.mb: float | None = None
        self.gpu_mb: float | None = None
        self._stop = threading.Event()
        self._sampler: threading.Thread | None = None

    def __enter__(self) -> PeakMemory:
        gc.collect()
        free_buffers()
        if self._on_gpu:
            torch.cuda.reset_peak_memory_stats()
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")
        peak, current = _read("VmHWM"), _read("VmRSS")
        self.mb = current
        if current is not None and (peak is None or peak > current + ROUNDING_MB):
            self._sampler = threading.Thread(target=self._sample, name="peak-memory", daemon=True)
            self._sampler.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._on_gpu:
            self.gpu_mb = round(torch.cuda.max_memory_reserved() / 2**20, 1)
        if self._sampler is not None:
            self._stop.set()
            self._sampler.join()
        elif self.mb is not None:
            self.mb = _read("VmHWM")

    def _sample(self) -> None:
        while not self._stop.wait(SAMPLE_SECONDS):
            self.mb = max(self.mb or 0.0, _read("VmRSS") or 0.0)


def _read(field: str) -> float | None:
    """Return the field of /proc/self/status, MB; None if it is not there."""
    kilobytes = proc_field(STATUS, field)
    return round(int(kilobytes.split()[0]) / 1024, 1) if kilobytes else None


def proc_field(file: Path, field: str) -> str:
    """Return the first value of a field in a file of /proc; empty if it is not there."""
    with contextlib.suppress(OSError):
        for line in file.read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == field:
                return value.strip()
    return ""
