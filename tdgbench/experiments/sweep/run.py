"""A sweep: one cell per job; afterwards tables, pictures and a report of all cells in the experiment's folder.

A job writes its cell's outcome for the summary at the end. No failure ends the sweep.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime, timedelta
from pathlib import Path

from hydra.conf import HydraConf
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from pydantic import TypeAdapter

from tdgbench.bench.failures import error_message
from tdgbench.bench.options import OptionError, check_cell_names
from tdgbench.bench.progress import CellProgress, Outcome
from tdgbench.bench.run_cell import run_cell
from tdgbench.bench.signature import Problem
from tdgbench.cells.plan import Jobs, number_of_jobs, plan_of_job, read_plan, swept
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.sweep.plan import finished_outcomes, plan_before, plan_sweep
from tdgbench.files import content_of, write_text
from tdgbench.splats.cpu import pool
from tdgbench.terminal import console, say
from tdgbench.text import duration

OUTCOME = "outcome.json"
BASIC_LAUNCHER = "hydra._internal.core_plugins.basic_launcher.BasicLauncher"  # one job after the other
_SCHEMA = TypeAdapter(Outcome)


class Sweep(Experiment):
    """Cells of methods on scenes; the default of `conf/config.yaml`."""

    def check(self, cfg: DictConfig) -> None:
        super().check(cfg)
        what = "is an option of experiments (+experiment=NAME); a sweep takes seed=0,1 and scene=A,B with -m"
        problems = [Problem(f"study.{name}", what) for name in cfg.study if name != "_target_"]
        if problems and type(self) is Sweep:  # a subclass may have options
            raise OptionError(problems)

    def start(self, cfg: DictConfig) -> None:
        """Write the plan, and end the run here if no job has anything to do."""
        chosen = {
            group: None if group in swept(cfg) else cfg.hydra.runtime.choices.get(group) for group in ("method", "init")
        }
        if "method" not in swept(cfg):
            check_cell_names(cfg, chosen)
        jobs = Jobs(cfg)
        plan, cells, without_data = plan_sweep(cfg, jobs)
        folder, outcomes = Path(cfg.results) / cfg.name, finished_outcomes(cfg, jobs, plan)
        if outcomes:
            plan.commands = plan_before(folder).commands or plan.commands  # this one runs nothing
        else:
            plan.write(Path(cfg.hydra.sweep.dir))  # for the jobs: another sweep may replace the other one meanwhile
        plan.write(folder)  # for the tables
        for outcome in outcomes:
            _say_outcome(outcome)
        if outcomes or without_data == cells:
            _finish(cfg, outcomes or [Outcome("missing", "")] * cells)
            raise SystemExit(0)

    def run(self, cfg: DictConfig) -> None:
        """Run the cell of a job, print its outcome in one line, and write the outcome to the job's folder."""
        hydra = HydraConfig.get()
        outcome = _outcome(cfg, hydra)
        folder = Path(hydra.runtime.output_dir)
        with suppress(OSError):  # the summary says which job left no outcome
            folder.mkdir(parents=True, exist_ok=True)
            write_text(folder / OUTCOME, json.dumps(asdict(outcome)))
        _say_outcome(outcome)
        sweep = Path(hydra.sweep.dir)
        cells = read_plan(sweep).cells_with_data
        workers = cells_at_once(hydra.launcher, pool.available_cores(), cells)
        if outcome.status in ("ok", "failed") and workers is not None:
            left = remaining_time(cells, list(numbered_outcomes(sweep).values()), workers)
            if left:
                say(f"{cfg.name}: {left}", stderr=True)

    def end(self, cfg: DictConfig, jobs: Path) -> None:
        _finish(cfg, read_outcomes(jobs, number_of_jobs(cfg)))


def _say_outcome(outcome: Outcome) -> None:
    if outcome.status != "missing":
        say(outcome.line, stderr=True)


def _finish(cfg: DictConfig, outcomes: list[Outcome]) -> None:
    from tdgbench.experiments.sweep.finish import finish  # pandas, SciPy's statistics, Matplotlib: 75 MB of memory

    finish(cfg, outcomes)


def _outcome(cfg: DictConfig, hydra: HydraConf) -> Outcome:
    """Return the outcome of the job's cell; a job that describes no cell has failed."""
    overrides = list(hydra.overrides.task)
    title = " ".join(overrides)
    try:
        plan = plan_of_job(Path(hydra.sweep.dir))
        title = plan.title(overrides)
        check_cell_names(cfg, hydra.runtime.choices)
        cores = pool.available_cores()
        if cfg.threads is None:
            cfg.threads = worker_threads(hydra.launcher, cores, plan.cells_with_data)
        at_once = cells_at_once(hydra.launcher, cores, plan.cells_with_data)
        progress = CellProgress(console(stderr=True), cfg.budget.iterations, cells_at_once=at_once)
        return run_cell(cfg, plan.variant(overrides), progress)
    except Exception as error:
        return Outcome("failed", title or "the cell", error_message(error))


def worker_threads(launcher: DictConfig, cores: int, cells: int) -> int | None:
    """Return the threads of one cell, so that the cells that a launcher runs at once share the cores; None: all cores.

    launcher: joblib configures the number of workers (negative: one per core), submitit and ray the cores per worker.
    cells: number of cells of the sweep.

    >>> worker_threads(DictConfig({"n_jobs": -1}), cores=8, cells=4)
    2
    """
    if launcher.get("ray") is not None:
        return max(1, int(launcher.ray.remote.get("num_cpus", 1)))
    if launcher.get("cpus_per_task") is not None:
        return int(launcher.cpus_per_task)
    if launcher.get("n_jobs") is not None:
        return max(1, cores // (cells_at_once(launcher, cores, cells) or 1))
    return None


def cells_at_once(launcher: DictConfig, cores: int, cells: int) -> int | None:
    """Return the number of cells, of those of the sweep, that a launcher runs at once; None where a queue decides.

    >>> cells_at_once(DictConfig({"n_jobs": 2}), cores=8, cells=9)
    2
    """
    if launcher.get("n_jobs") is not None:
        workers = cores if launcher.n_jobs < 0 else int(launcher.n_jobs)
        return max(1, min(workers, cells or workers))
    return 1 if launcher.get("_target_") == BASIC_LAUNCHER else None


def remaining_time(cells: int, outcomes: Sequence[Outcome], workers: int, now: datetime | None = None) -> str:
    """Return the number of cells that are still to run, and the time they take if each takes the mean of the finished.

    cells: number of cells whose scene is there. outcomes: of the jobs so far. workers: cells that run at once. Empty
    before the first finished cell, and after the last.

    >>> done = [Outcome("ok", "tdg on a", seconds=1800.0), Outcome("kept", "tdg on b")]
    >>> remaining_time(3, done, workers=1, now=datetime(2024, 1, 1, 12))
    '1 of 3 cells to go, about 0:30:00 left (until Mon 12:30)'
    """
    seconds = [outcome.seconds for outcome in outcomes if outcome.status == "ok"]
    left = cells - sum(outcome.status != "missing" for outcome in outcomes)
    if not seconds or left < 1:
        return ""
    time = sum(seconds) / len(seconds) * left / min(workers, left)
    end = (now or datetime.now()) + timedelta(seconds=time)
    return f"{left} of {cells} cells to go, about {duration(time)} left (until {end:%a %H:%M})"


def read_outcomes(hydra_folder: Path, jobs: int | None = None) -> list[Outcome]:
    """Return the outcomes of the jobs of a run or sweep, in the order of the jobs.

    jobs: their number, where it is known. One that left no readable outcome has failed.
    """
    outcomes = numbered_outcomes(hydra_folder)
    silent = sorted(set(range(jobs or 0)) - set(outcomes))[: max(0, (jobs or 0) - len(outcomes))]
    outcomes |= {number: Outcome("failed", f"job {number}", f"left no outcome in {hydra_folder}") for number in silent}
    return [outcomes[number] for number in sorted(outcomes)]


def numbered_outcomes(hydra_folder: Path) -> dict[int, Outcome]:
    """Return the outcomes of the jobs that have ended, by number; that of a single run has the number -1."""
    found = {path.parent.name: _read(path) for path in hydra_folder.rglob(OUTCOME)}
    return {int(job) if job.isdigit() else -1: outcome for job, outcome in found.items()}


def _read(path: Path) -> Outcome:
    try:
        return _SCHEMA.validate_json(content_of(path))
    except (OSError, ValueError) as error:
        return Outcome("failed", f"job {path.parent.name}", f"{path} is no outcome: {str(error).splitlines()[0]}")
