"""Peak memory of one cell, in RAM and on the GPU, where many cells run in one process."""

from __future__ import annotations

import contextlib
import gc
import threading
from pathlib import Path

import torch

from tdgbench.splats.cpu.scratch import release

STATUS = Path("/proc/self/status")
SAMPLE_SECONDS = 0.02
ROUNDING_MB = 16.0


class PeakMemory:
    """Context that measures peak memory. It begins by giving back what cells before it left.

    mb: largest resident size, MB; None where the platform does not report it. gpu_mb: most memory of the current GPU
    that torch reserved, MB; None unless `on_gpu`.

    Linux tracks the peak and lets a process reset it. Where the reset has no effect (some sandboxes), a thread samples
    the current size instead.
    """

    def __init__(self, on_gpu: bool = False) -> None:
        """on_gpu: the work is on the current CUDA GPU."""
        self._on_gpu = on_gpu
        self.mb: float | None = None
        self.gpu_mb: float | None = None
        self._stop = threading.Event()
        self._sampler: threading.Thread | None = None

    def __enter__(self) -> PeakMemory:
        gc.collect()
        release()
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
    """Field of /proc/self/status, MB; None if it is not there."""
    with contextlib.suppress(OSError):
        for line in STATUS.read_text(encoding="utf-8").splitlines():
            if line.startswith(f"{field}:"):
                return round(int(line.split()[1]) / 1024, 1)
    return None
