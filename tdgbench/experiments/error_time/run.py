"""`+experiment=error_time` and `+experiment=budgets`: quality of the test views against the time of trainings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from pydantic import BaseModel, Field, PositiveFloat

from tdgbench.bench.scores import score_views
from tdgbench.bench.setup import loader_of, set_up
from tdgbench.experiments.error_time.curves import CURVE_METRICS, attribution, draw_curves, faster_by
from tdgbench.experiments.experiment import Experiment, prepare_prior
from tdgbench.experiments.show import show_table
from tdgbench.files import write_text
from tdgbench.scenes import Scene
from tdgbench.scoring import Scorer, mean_scores
from tdgbench.splats.cpu import pool
from tdgbench.tables.as_csv import as_csv
from tdgbench.terminal import console, say
from tdgbench.training.budget import Budget
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Method
from tdgbench.training.skips import Skips


class Run(BaseModel, extra="forbid", strict=True, allow_inf_nan=False, frozen=True):
    """A training of the chain: a method, overrides of its options, and its share of the budget's iterations.

    budget: its name in `study.budgets`; None: that of the configuration.
    """

    label: str
    method: str
    share: PositiveFloat = 1.0
    options: dict[str, Any] = {}
    budget: str | None = None


@dataclass(frozen=True)
class ErrorTimeOptions:
    """Options in `cfg.study`; `conf/experiment/error_time.yaml` says what they are."""

    methods: dict[str, Any]
    scenes: list[str | None]
    samples: Annotated[int, Field(ge=2)]
    runs: list[Run]
    budgets: dict[str, Any] = field(default_factory=dict)
    chain: bool = True


class ErrorTime(Experiment):
    """Training time against the error of the test views."""

    options = ErrorTimeOptions
    sets: ClassVar[Mapping[str, str]] = {"scene": "study.scenes=[NAME,...]", "method": "study.runs"}

    def start(self, cfg: DictConfig) -> None:
        """Prepare the depth priors. Raises PriorUnavailableError if a training needs a prior that is not available."""
        for run in runs_of(cfg):
            cell = cfg.copy()
            cell.method = cfg.study.methods[run.method]
            prepare_prior(cell)

    def run(self, cfg: DictConfig) -> None:
        """Sample the curves, write and print the tables. Raises SystemExit(1) if a training failed."""
        self.check(cfg)
        pool.set_threads(cfg.threads)
        torch.set_num_threads(1)
        folder = Path(cfg.results) / cfg.name
        folder.mkdir(parents=True, exist_ok=True)
        curves, failed = sample_all(cfg)
        _write(curves, folder / "curves.csv")
        if not curves.empty:
            _compare(curves, [run.label for run in runs_of(cfg)], folder, is_chain=bool(cfg.study.get("chain", True)))
        say(f"tables and pictures: {folder}")
        if failed:
            raise SystemExit(1)


class Budgets(ErrorTime):
    """Training time against error with each budget: every run names its own."""

    sets: ClassVar[Mapping[str, str]] = {**ErrorTime.sets, "budget": "study.budgets.NAME.KEY=VALUE or study.runs"}


def runs_of(cfg: DictConfig) -> list[Run]:
    """Return the chain in `cfg.study.runs`. Raises ValueError for a method or budget that is not in `cfg.study`."""
    budgets = cfg.study.get("budgets", {})
    runs: list[Run] = []
    for options in cfg.study.runs:
        run = Run.model_validate(OmegaConf.to_container(options, resolve=True))
        if run.method not in cfg.study.methods:
            raise ValueError(f"run {run.label!r}: no method {run.method!r} among {', '.join(cfg.study.methods)}")
        if run.budget is not None and run.budget not in budgets:
            raise ValueError(f"run {run.label!r}: no budget {run.budget!r} among {', '.join(budgets)}")
        if run.label in [other.label for other in runs]:
            raise ValueError(f"two runs have the label {run.label!r} in study.runs")
        runs.append(run)
    return runs


def sample_all(cfg: DictConfig) -> tuple[pd.DataFrame, int]:
    """Return the curves of all scenes and runs, and the number of failed runs; these do not stop the others."""
    curves, failed = [], 0
    for scene in cfg.study.scenes:
        for run in runs_of(cfg):
            try:
                curve = sample_curve(cfg, scene, run, int(cfg.study.samples))
            except Exception as error:
                failed += 1
                say(f"{scene}, {run.label}: {type(error).__name__}: {error}", "failed:")
                continue
            curves.append(curve)
            end = curve.iloc[-1]
            reached = f"{end.psnr:.2f} dB after {end.iteration} iterations and {end.seconds:.1f} s"
            say(f"{end.scene}, {run.label}: {reached}")
    columns = ["scene", "label", "iteration", "seconds", "processor_seconds", "gaussians", *CURVE_METRICS]
    return (pd.concat(curves, ignore_index=True) if curves else pd.DataFrame(columns=columns)), failed


def sample_curve(cfg: DictConfig, scene_name: str | None, run: Run, samples: int) -> pd.DataFrame:
    """Train one link and score the test views at `samples` iterations, evenly spaced on a logarithmic scale, and at the
    end, which may come before the budget's.

    A sample right after density control waits until the models have recovered, so that each point of the curve is a
    model as it would be saved. The clock stops while views are scored.
    """
    cfg = cfg.copy()
    cfg.scene, cfg.method = scene_name, cfg.study.methods[run.method]
    if run.budget is not None:
        cfg.budget = cfg.study.budgets[run.budget]
    skips: Skips = instantiate(cfg.skip)
    scene: Scene = instantiate(loader_of(cfg, skips)).load(scene_name)
    cfg.budget.iterations = max(1, round(int(cfg.budget.iterations) * run.share))
    unready: Method = instantiate(OmegaConf.merge(cfg.study.methods[run.method].method, run.options))
    trainer, scene, response = set_up(cfg, scene, method=unready, skips=skips)
    scorer: Scorer = instantiate(cfg.metrics)
    sampled = _sampled_iterations(trainer.whole_context.budget, samples)
    rows: list[dict[str, Any]] = []

    def sample(log: TrainingLog) -> None:
        if log.iterations not in sampled and not log.ended:
            return
        scores = mean_scores(score_views(trainer, scene, scorer, response))
        gaussians = sum(len(model) for model in trainer.gaussians.values())
        rows.append(
            {
                "scene": scene.name,
                "label": run.label,
                "iteration": log.iterations,
                "seconds": log.seconds,
                "processor_seconds": log.processor_seconds,
                "gaussians": gaussians,
                **{m: scores[m] for m in CURVE_METRICS},
            }
        )

    train(trainer, before_update=sample)
    return pd.DataFrame(rows)


def _sampled_iterations(budget: Budget, samples: int) -> set[int]:
    """Return the iterations to sample: logarithmically spaced, each moved on until the models have recovered."""
    end, rules = budget.iterations, budget.density
    even = np.geomspace(min(20, end), end, samples).round().astype(int)
    return {next(i for i in range(first, end + 1) if rules.has_recovered(i, end)) for first in even}


def _compare(curves: pd.DataFrame, labels: list[str], folder: Path, is_chain: bool) -> None:
    """Write the figure; write and print the time saved, and what each step of a chain contributes."""
    savings = faster_by(curves, labels[0], labels[1:])
    _write(savings, folder / "faster.csv")
    show_table(savings, console(), f"time saved against {labels[0]}")
    if is_chain:
        contributions = attribution(curves, labels)
        _write(contributions, folder / "attribution.csv")
        show_table(contributions, console(), f"contribution of each step after {labels[0]} to the speed-up")
    draw_curves(curves, folder / "curves.png")


def _write(table: pd.DataFrame, target: Path) -> None:
    write_text(target, as_csv(table, na_rep="n/a"))
