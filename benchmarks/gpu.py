"""`python -m benchmarks.gpu [hydra overrides]`: what the GPU backends do on this machine, by one command.

It runs the tests marked `cuda`, the check of each backend, and trainings: each backend, method and budget several times
with one seed, and a profile of its steps. It prints a table and writes OUT/gpu.json. Seconds and bytes are those of
this machine; repetitions with equal bytes are deterministic. Without a GPU it runs `warp` on the CPU: use small images.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console
from torch.profiler import ProfilerActivity, profile

from tdgbench.bench.backend_check.check import check
from tdgbench.bench.environment import describe_environment
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.bench.run_cell import run_cell
from tdgbench.bench.setup import set_up
from tdgbench.bench.stored import hashes_of_content
from tdgbench.files import write_text
from tdgbench.resources import conf_folder
from tdgbench.splats.backends import ON_GPU, load_backend
from tdgbench.training.loop import train

PROFILED_STEPS = 30
LONGEST = 12  # operations of a profile that are kept


def run_tests() -> dict[str, Any]:
    """Run the tests marked `cuda`; returns exit status and the last line."""
    command = [sys.executable, "-m", "pytest", "-m", "cuda", "-p", "no:cacheprovider", "tests"]
    run = subprocess.run(command, capture_output=True, text=True)
    return {"status": run.returncode, "summary": (run.stdout.strip().splitlines() or [run.stderr])[-1]}


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


def profile_steps(overrides: Sequence[str]) -> list[dict[str, Any]]:
    """Return the longest operations of a training's steps: name, calls and milliseconds per step, on host and GPU."""
    cfg = configuration([*overrides, f"budget.iterations={PROFILED_STEPS}"])
    scene = instantiate(cfg.dataset.loader).load(cfg.scene)
    train(set_up(cfg, scene).trainer)  # compiles
    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if torch.cuda.is_available() else [])]
    trainer = set_up(cfg, scene).trainer
    with profile(activities=activities) as found:
        train(trainer)
    rows = [
        {
            "operation": event.key,
            "calls": event.count / PROFILED_STEPS,
            "host_ms": event.self_cpu_time_total / 1e3 / PROFILED_STEPS,
            "gpu_ms": event.self_device_time_total / 1e3 / PROFILED_STEPS,
        }
        for event in found.key_averages()
    ]
    return sorted(rows, key=lambda row: -max(row["host_ms"], row["gpu_ms"]))[:LONGEST]


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Run everything that the arguments name, and return what was found."""
    found: dict[str, Any] = {"environment": describe_environment(), "overrides": args.overrides}
    found["tests"] = run_tests() if args.tests else "not run"
    found["checks"], found["trainings"], found["profiles"] = {}, [], {}
    for backend in args.backends:
        reason = load_backend(backend).why_not()
        found["checks"][backend] = {"reason": reason} if reason is not None else asdict(check(backend))
        if reason is not None:
            continue
        for method in args.methods:
            for budget in args.budgets:
                overrides = [f"method={method}", f"budget={budget}", f"backend={backend}", *args.overrides]
                runs = [train_cell(overrides, args.out / f"cell{number}") for number in range(args.repetitions)]
                models = [json.dumps(run.get("model"), sort_keys=True) for run in runs]
                same = len(set(models)) == 1 if "null" not in models else None  # None: a run failed
                row = {"backend": backend, "method": method, "budget": budget, "equal_bytes": same, "runs": runs}
                found["trainings"].append(row)
            found["profiles"][f"{backend}, {method}"] = profile_steps(overrides)
    return found


def table(found: dict[str, Any]) -> pd.DataFrame:
    """Return a row per backend, method and budget: seconds and dB of each repetition, and whether bytes are equal."""
    rows = []
    for row in found["trainings"]:
        runs = {
            name: " ".join(f"{run[key]:.{digits}f}" if key in run else "failed" for run in row["runs"])
            for name, key, digits in (("seconds", "seconds", 1), ("PSNR dB", "psnr_db", 3))
        }
        names = {name: row[name] for name in ("backend", "method", "budget")}
        rows.append({**names, **runs, "equal bytes": {True: "yes", False: "no", None: "n/a"}[row["equal_bytes"]]})
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gpu", description=__doc__)
    parser.add_argument("overrides", nargs="*", help="of each cell, such as scene=night seed=1")
    parser.add_argument("--backends", nargs="+", default=list(ON_GPU), choices=ON_GPU)
    parser.add_argument("--methods", nargs="+", default=["tdg", "msmg"])
    parser.add_argument("--budgets", nargs="+", default=["paper", "lean"])
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--no-tests", dest="tests", action="store_false", help="leave out the tests marked `cuda`")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found = measure(args)
    print(f"tests: {found['tests']}")
    for backend, verdict in found["checks"].items():
        print(f"check of {backend}: {verdict}")
    print(table(found).to_string(index=False))
    write_text(args.out / "gpu.json", json.dumps(found, indent=1, default=str))
    print(f"all of it: {args.out / 'gpu.json'}")


if __name__ == "__main__":
    main()
