"""`+experiment=error_time`: measure kernels, training and growth of cost; write tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import pandas as pd
import torch
from omegaconf import DictConfig
from pydantic import BaseModel, Field, PositiveFloat, PositiveInt
from rich.console import Console

from tdgbench import terminal
from tdgbench.bench.options import OptionError
from tdgbench.bench.signature import Problem
from tdgbench.experiments.error_time import growth, kernels, training
from tdgbench.experiments.error_time.clouds import Cloud, random_cloud, trained_cloud
from tdgbench.experiments.error_time.draw import draw_curves, draw_growth, draw_pareto
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.preparation import prepare_prior
from tdgbench.experiments.show import show
from tdgbench.files import write_text
from tdgbench.splats.cpu import pool
from tdgbench.tables.as_csv import as_csv

KERNEL_COLUMNS = {  # those on the terminal, and their titles there
    "setting": "setting", "forward_ms": "fwd ms", "both_ms": "+ bwd ms", "both_ratio": "ratio", "image_error": "image",
    "depth_error": "depth", "gradient_error": "gradient", "non_dominated": "best",
}  # fmt: skip


class RunOptions(BaseModel, extra="forbid", strict=True, allow_inf_nan=False):
    """A link of the chain of trainings: see `training.Run`."""

    label: str
    method: str
    share: PositiveFloat = 1.0
    options: dict[str, Any] = {}
    budget: str | None = None


@dataclass(frozen=True)
class ErrorTimeOptions:
    """Options in `cfg.job`; `conf/experiment/error_time.yaml` says what they are."""

    methods: dict[str, Any]
    parts: Annotated[list[Literal["kernels", "training", "growth"]], Field(min_length=1)]
    counts: list[PositiveInt]
    width: PositiveInt
    height: PositiveInt
    repetitions: PositiveInt
    slow: bool
    model: str | None
    scenes: list[str | None]
    samples: Annotated[int, Field(ge=2)]
    runs: list[RunOptions]
    largest: PositiveInt
    budgets: dict[str, Any] = field(default_factory=dict)
    chain: bool = True


class ErrorTime(Experiment):
    """Run time against error."""

    options = ErrorTimeOptions
    sets: ClassVar[Mapping[str, str]] = {"scene": "job.scenes=[NAME,...]", "method": "job.runs"}

    def start(self, cfg: DictConfig) -> None:
        """Raises PriorUnavailableError if a training needs a prior that is not available."""
        if "kernels" in cfg.job.parts and not cfg.job.counts and cfg.job.model is None:
            problem = "needs job.counts, numbers of Gaussians, or job.model, for its part `kernels`"
            raise OptionError([Problem("job.parts", problem, cfg.job.parts)])
        if "training" in cfg.job.parts:
            for one in training.runs_of(cfg):
                cell = cfg.copy()
                cell.method = cfg.job.methods[one.method]
                prepare_prior(cell)

    def run(self, cfg: DictConfig) -> None:
        """Measure the parts in `cfg.job.parts`. Raises SystemExit(1) if a training failed."""
        self.check(cfg)
        pool.set_threads(cfg.threads)
        torch.set_num_threads(1)
        console, folder = terminal.console(), Path(cfg.results) / cfg.name
        folder.mkdir(parents=True, exist_ok=True)
        failed = 0
        if "kernels" in cfg.job.parts:
            _measure_kernels(cfg, folder, console)
        if "training" in cfg.job.parts:
            failed = _measure_training(cfg, folder, console)
        if "growth" in cfg.job.parts:
            _measure_growth(cfg, folder, console)
        terminal.say(f"tables and pictures: {folder}")
        if failed:
            raise SystemExit(1)


class Budgets(ErrorTime):
    """Training time against error with each budget: every run names its own."""

    sets: ClassVar[Mapping[str, str]] = {**ErrorTime.sets, "budget": "job.budgets.NAME.KEY=VALUE or job.runs"}


def _measure_kernels(cfg: DictConfig, folder: Path, console: Console) -> None:
    job = cfg.job
    size = f"{job.width}×{job.height}"
    clouds: dict[str, Cloud] = {
        f"{count:,} random, {size}": random_cloud(int(count), int(job.width), int(job.height)) for count in job.counts
    }
    if job.model is not None:
        clouds["trained"] = trained_cloud(Path(job.model), Path(cfg.data.root))
    table = kernels.measure(clouds, int(job.repetitions), bool(job.slow))
    table["non_dominated"] = False
    for _, rows in table.groupby("scene", sort=False):
        table.loc[rows.index, "non_dominated"] = kernels.non_dominated(rows, "both_ms", "gradient_error")
    _write(table, folder / "kernels.csv")
    for scene, rows in table.groupby("scene", sort=False):
        columns = rows[list(KERNEL_COLUMNS)].rename(columns=KERNEL_COLUMNS)
        show(columns, console, f"{scene}: errors against float64")
    draw_pareto(table, folder / "pareto.png")


def _measure_training(cfg: DictConfig, folder: Path, console: Console) -> int:
    """Measure the training curves; return the number of failed trainings."""

    def report(scene: str, label: str, result: pd.DataFrame | Exception) -> None:
        if isinstance(result, Exception):
            message = f"{scene}, {label}: {type(result).__name__}: {result}"
            terminal.say(message, "failed:")
            return
        last = result.iloc[-1]
        terminal.say(f"{scene}, {label}: {last.psnr:.2f} dB after {last.iteration} iterations and {last.seconds:.1f} s")

    curves, failed = training.sample_all(cfg, report)
    _write(curves, folder / "curves.csv")
    if not curves.empty:
        labels = [one.label for one in training.runs_of(cfg)]
        _compare_trainings(curves, labels, folder, console)
        if cfg.job.get("chain", True):
            _attribute(curves, labels, folder, console)
        draw_curves(curves, folder / "curves.png")
    return failed


def _compare_trainings(curves: pd.DataFrame, labels: list[str], folder: Path, console: Console) -> None:
    """Write milestones; write and print the time saved against the first training."""
    savings = training.faster_by(curves, labels[0], labels[1:])
    _write(training.milestones(curves), folder / "milestones.csv")
    _write(savings, folder / "faster.csv")
    show(savings, console, f"time saved against {labels[0]}")


def _attribute(curves: pd.DataFrame, labels: list[str], folder: Path, console: Console) -> None:
    """Write and print what each step of a chain contributes."""
    contributions = training.attribution(curves, labels)
    _write(contributions, folder / "attribution.csv")
    show(contributions, console, f"contribution of each step after {labels[0]} to the speed-up")


def _measure_growth(cfg: DictConfig, folder: Path, console: Console) -> None:
    job = cfg.job
    table = growth.measure(int(job.largest), int(job.width), int(job.height), int(job.repetitions))
    fitted = growth.exponents(table)
    _write(table, folder / "growth.csv")
    _write(fitted, folder / "growth_exponents.csv")
    show(fitted, console, "cost ∝ size^exponent")
    draw_growth(table, fitted, folder / "growth.png")


def _write(table: pd.DataFrame, target: Path) -> None:
    write_text(target, as_csv(table, na_rep="n/a"))
