"""What Hydra runs once per cell, and the note each job leaves for the end of the sweep."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from tdgbench.bench.cell import Outcome, run_cell
from tdgbench.bench.plan import read_plan
from tdgbench.bench.progress import CellProgress
from tdgbench.files import write_text
from tdgbench.splats.cpu import pool

OUTCOME = "outcome.json"


def run_job(cfg: DictConfig) -> None:
    """Run a cell, say in one line what became of it, and note the outcome in the job's folder."""
    console = Console(stderr=True)
    hydra = HydraConfig.get()
    if cfg.threads is None:
        cfg.threads = worker_threads(hydra.launcher, pool.available_cores())
    variant = read_plan(Path(cfg.results) / cfg.name).variant(list(hydra.overrides.task))
    outcome = run_cell(cfg, variant, CellProgress(console, int(cfg.budget.iterations)))
    folder = Path(hydra.runtime.output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / OUTCOME, json.dumps(asdict(outcome)))
    if outcome.status != "missing":
        words = {
            "ok": "done", "kept": "already there", "failed": "[red]failed[/red]", "elsewhere": "in another process",
        }  # fmt: skip
        why = f" ({escape(outcome.message)})" if outcome.status == "ok" and outcome.message else ""
        console.print(f"{escape(outcome.title)}: {words[outcome.status]}{why}", highlight=False, soft_wrap=True)


def worker_threads(launcher: DictConfig, cores: int) -> int | None:
    """Threads of one cell when a launcher runs several at once, so that together they use the cores once.

    joblib says how many workers there are (a negative number: as many as cores), submitit and ray how many cores each
    gets. None: the cell has the machine to itself.
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
    """The outcomes that the jobs of a run or sweep left, in the order of the jobs."""
    found = []
    for path in hydra_folder.rglob(OUTCOME):
        number = path.parent.name
        found.append((int(number) if number.isdigit() else -1, Outcome(**json.loads(path.read_text()))))
    return [outcome for _, outcome in sorted(found, key=lambda pair: pair[0])]
