"""One job of a sweep: run its cell, and write the outcome for the summary at the end."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from tdgbench.bench.cell import Outcome, run_cell
from tdgbench.bench.plan import read_plan
from tdgbench.bench.progress import CellProgress
from tdgbench.files import write_text
from tdgbench.splats.cpu import pool
from tdgbench.terminal import console, say

OUTCOME = "outcome.json"
WORDS = {
    "ok": "done",
    "kept": "already there",
    "failed": "failed",
    "elsewhere": "running in another process",
}


def run_job(cfg: DictConfig) -> None:
    """Run a cell, print its outcome in one line, and write the outcome to the job's folder."""
    hydra = HydraConfig.get()
    if cfg.threads is None:
        cfg.threads = worker_threads(hydra.launcher, pool.available_cores())
    variant = read_plan(Path(cfg.results) / cfg.name).variant(list(hydra.overrides.task))
    outcome = run_cell(cfg, variant, CellProgress(console(stderr=True), int(cfg.budget.iterations)))
    folder = Path(hydra.runtime.output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / OUTCOME, json.dumps(asdict(outcome)))
    if outcome.status != "missing":
        remark = f" ({outcome.message})" if outcome.status == "ok" and outcome.message else ""
        say(f"{outcome.title}: {WORDS[outcome.status]}{remark}", stderr=True)


def worker_threads(launcher: DictConfig, cores: int) -> int | None:
    """Threads of one cell, so that the cells that a launcher runs at once share the cores; None: all cores.

    launcher: joblib configures the number of workers (negative: one per core), submitit and ray the cores per worker.

    >>> worker_threads(DictConfig({"n_jobs": 2}), cores=8)
    4
    """
    if launcher.get("ray") is not None:
        return max(1, int(launcher.ray.remote.get("num_cpus", 1)))
    if launcher.get("cpus_per_task") is not None:
        return int(launcher.cpus_per_task)
    if launcher.get("n_jobs") is not None:
        workers = cores if launcher.n_jobs < 0 else max(1, int(launcher.n_jobs))
        return max(1, cores // workers)
    return None


def read_outcomes(hydra_folder: Path) -> list[Outcome]:
    """Outcomes of the jobs of a run or sweep, in the order of the jobs."""
    found = []
    for path in hydra_folder.rglob(OUTCOME):
        number = path.parent.name
        found.append((int(number) if number.isdigit() else -1, Outcome(**json.loads(path.read_text(encoding="utf-8")))))
    return [outcome for _, outcome in sorted(found, key=lambda pair: pair[0])]
