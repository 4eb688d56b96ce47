"""The parts that run in a process of their own: `python -m benchmarks.gpu.parts PART JSON` writes a JSON per line."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console
from torch.profiler import ProfilerActivity, profile

from tdgbench.bench.backend_check.check import check
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import run_cell
from tdgbench.bench.setup import set_up
from tdgbench.cells.folder import hashes_of_content
from tdgbench.cells.record import read_all
from tdgbench.resources import conf_folder
from tdgbench.training.loop import train

PROFILED_STEPS = 30
LONGEST = 12  # operations of a profile that are kept
COUNTED = {  # calls of CUDA's runtime and driver, and copies on the device, by their names in torch's profiler
    "launches": r"cu(da)?(Launch|GraphLaunch)",
    "synchronisations": r"cu(da)?(Device|Stream|Event|Ctx)Synchronize",
    "copies_to_gpu": r"Memcpy HtoD",
    "copies_from_gpu": r"Memcpy DtoH",
}


def configuration(overrides: Sequence[str]) -> DictConfig:
    """Compose the configuration of a cell."""
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        return compose("config", overrides=list(overrides))


def train_cell(overrides: Sequence[str], results: Path) -> dict[str, Any]:
    """Train and score a cell. Returns seconds, scores and hashes, or why it failed."""
    cfg = configuration([*overrides, f"results={results}", "name=cell", "overwrite=always"])
    outcome = run_cell(cfg, "", CellProgress(Console(quiet=True), 1000))
    (record,) = read_all(results / "cell")
    if outcome.status != "ok":
        return {"failed": record.why_failed or outcome.message}
    return {
        "seconds": record.seconds["train"],
        "psnr_db": record.scores["psnr"],
        "iterations": record.iterations,
        "gaussians": record.gaussians,
        "model": hashes_of_content(record.hashes),
        "peak_gpu_mb": record.peak_gpu_mb,
    }


def train_cells(overrides: Sequence[str], results: str, repetitions: int, seconds: float) -> Iterator[dict[str, Any]]:
    """Train a cell several times; none begins that would not end within so many seconds if it took as long as one."""
    start, longest = time.monotonic(), 0.0
    for number in range(repetitions):
        began = time.monotonic()
        if began - start + longest > seconds:
            return
        yield train_cell(overrides, Path(results) / f"cell{number}")
        longest = max(longest, time.monotonic() - began)


def profile_steps(overrides: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Profile the first steps of a training. Per step: counts of `COUNTED`, and the longest operations.

    Each of these has its name, calls and milliseconds on host and GPU. Without a GPU, counts are None.
    """
    cfg = configuration([*overrides, f"budget.iterations={PROFILED_STEPS}"])
    scene = instantiate(cfg.dataset.loader).load(cfg.scene)
    train(set_up(cfg, scene).trainer)  # compiles
    on_gpu = torch.cuda.is_available()
    trainer = set_up(cfg, scene).trainer
    with profile(activities=[ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if on_gpu else [])]) as found:
        train(trainer)
    events = list(found.key_averages())
    rows = [
        {
            "operation": event.key,
            "calls": event.count / PROFILED_STEPS,
            "host_ms": event.self_cpu_time_total / 1e3 / PROFILED_STEPS,
            "gpu_ms": event.self_device_time_total / 1e3 / PROFILED_STEPS,
        }
        for event in events
    ]
    counts = counted({event.key: event.count for event in events}) if on_gpu else dict.fromkeys(COUNTED)
    yield {**counts, "operations": sorted(rows, key=lambda row: -max(row["host_ms"], row["gpu_ms"]))[:LONGEST]}


def counted(calls: dict[str, int]) -> dict[str, float]:
    """Return the counts of `COUNTED` per step, of calls by name.

    >>> found = counted({"cuLaunchKernel": 60, "cudaLaunchKernel": 30, "Memcpy HtoD (Pinned -> Device)": 30})
    >>> found["launches"], found["copies_to_gpu"], found["synchronisations"]
    (3.0, 1.0, 0.0)
    """
    return {
        what: sum(count for name, count in calls.items() if re.match(pattern, name)) / PROFILED_STEPS
        for what, pattern in COUNTED.items()
    }


PARTS: dict[str, Callable[..., Iterator[dict[str, Any]]]] = {
    "check": lambda backend: iter([asdict(check(backend))]),
    "train": train_cells,
    "profile": profile_steps,
}


def main() -> None:
    part, given = sys.argv[1], json.loads(sys.argv[2])
    for found in PARTS[part](**given):
        print("\n" + json.dumps(found, default=str), flush=True)


if __name__ == "__main__":
    main()
