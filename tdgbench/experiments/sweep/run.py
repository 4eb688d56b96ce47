"""A sweep: one cell per job; afterwards tables, pictures and a report of all cells in the experiment's folder."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from tdgbench.bench.outcome import Outcome
from tdgbench.bench.plan import number_of_jobs
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.sweep.job import read_outcomes, run_job
from tdgbench.experiments.sweep.plan import plan_sweep


class Sweep(Experiment):
    """Cells of methods on scenes; the default of `conf/config.yaml`."""

    def start(self, cfg: DictConfig) -> None:
        cells = plan_sweep(cfg)
        if cells.without_data == cells.total:  # no job has anything to do
            _finish(cfg, [Outcome("missing", "")] * cells.total)

    def run(self, cfg: DictConfig) -> None:
        run_job(cfg)

    def end(self, cfg: DictConfig, jobs: Path) -> None:
        _finish(cfg, read_outcomes(jobs, number_of_jobs(cfg)))


def _finish(cfg: DictConfig, outcomes: list[Outcome]) -> None:
    from tdgbench.experiments.sweep.finish import finish  # pandas, SciPy's statistics, Matplotlib: 75 MB of memory

    finish(cfg, outcomes)
