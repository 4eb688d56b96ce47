"""`+experiment=error_time` and `+experiment=budgets`: quality of the test views against the time of trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
import torch
from hydra.utils import instantiate
from matplotlib.figure import Figure
from omegaconf import DictConfig, OmegaConf
from pydantic import BaseModel, Field, PositiveFloat

from tdgbench.bench.backend_check.choose import training_backend
from tdgbench.bench.failures import error_message
from tdgbench.bench.options import OptionError
from tdgbench.bench.record_of_run import state_assumptions, state_values
from tdgbench.bench.scores import score_views
from tdgbench.bench.setup import loader_of, set_up
from tdgbench.bench.signature import Problem
from tdgbench.cells.paths import prior_cache
from tdgbench.cells.record import Record
from tdgbench.experiments.experiment import Experiment, prepare_prior
from tdgbench.experiments.matrix import write_tables
from tdgbench.present.figures import plain, save_figure
from tdgbench.scenes import Scene
from tdgbench.scoring import METRICS, Scorer, mean_scores
from tdgbench.splats.cpu import pool
from tdgbench.tables.claims.quantities import first_at
from tdgbench.tables.likeness import BUSY, wall_by_processor_time
from tdgbench.tables.palette import IMAGES, image_values
from tdgbench.tables.show import format_columns, show_table
from tdgbench.terminal import say
from tdgbench.training.budget import Budget
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.skips import Skips

CURVE_METRICS = ("psnr", "ssim", "lpips", "depth_abs_rel")
MARKERS = "osD^vP*X"


class SampledRun(BaseModel, extra="forbid", strict=True, allow_inf_nan=False, frozen=True):
    """A training: a method, overrides of its options, and its share of the budget's iterations.

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
    scenes: Annotated[list[str | None], Field(min_length=1)]
    samples: Annotated[int, Field(ge=2)]
    runs: Annotated[list[SampledRun], Field(min_length=1)]
    budgets: dict[str, Any] = field(default_factory=dict)


class ErrorTime(Experiment):
    """Training time against the error of the test views."""

    options = ErrorTimeOptions
    one_job = True
    sets: ClassVar[Mapping[str, str]] = {"scene": "study.scenes=[NAME,...]", "method": "study.runs"}

    def start(self, cfg: DictConfig) -> None:
        prepare_prior(cfg, [cfg.study.methods[run.method] for run in runs_of(cfg)])

    def run(self, cfg: DictConfig) -> None:
        self.check(cfg)
        folder = Path(cfg.results) / cfg.name
        curves, failed = sample_all(cfg)
        if not curves.empty:
            first, *others = [run.label for run in runs_of(cfg)]
            savings = faster_by(curves, first, others)
            write_tables(folder, {"curves": curves, "faster": savings})
            ends = curves.groupby(["scene", "label"], sort=False).tail(1)
            if busy := [f"{one.label} on {one.scene}" for one in ends[ends["busy"]].itertuples()]:
                say(f"times of {', '.join(busy)}, from which other work took processor time", "n/a:", "yellow")
            shown = {
                name: (name, "{}" if name in ("scene", "label") else "{:.3g}")
                for name in savings
                if name not in (IMAGES, "baseline")
            }
            show_table(format_columns(savings, shown), f"time saved against {first}")
            draw_curves(curves, folder / "curves.png")
            say(f"tables and pictures: {folder}")
        if failed:
            raise SystemExit(1)


class Budgets(ErrorTime):
    """Training time against error with each budget: every run names its own."""

    sets: ClassVar[Mapping[str, str]] = {**ErrorTime.sets, "budget": "study.budgets.NAME.KEY=VALUE or study.runs"}


def runs_of(cfg: DictConfig) -> list[SampledRun]:
    """Return the trainings in `cfg.study.runs`. Raises OptionError for what does not fit the rest of `cfg.study`."""
    methods, budgets = cfg.study.methods, cfg.study.get("budgets", {})
    runs: list[SampledRun] = []
    for options in cfg.study.runs:
        run = SampledRun.model_validate(OmegaConf.to_container(options, resolve=True))
        wrong = ""
        if run.method not in methods:
            wrong = f"there is no method {run.method!r} in study.methods (there are {', '.join(methods)})"
        elif unknown := run.options.keys() - methods[run.method].method.keys():
            wrong = f"{run.method} has no option {', '.join(sorted(unknown))}"
        elif run.budget is not None and run.budget not in budgets:
            wrong = f"there is no budget {run.budget!r} in study.budgets (there are {', '.join(budgets) or 'none'})"
        elif run.label in [other.label for other in runs]:
            wrong = "another run has this label"
        if wrong:
            raise OptionError([Problem("study.runs", f"run {run.label!r}: {wrong}")])
        runs.append(run)
    return runs


def configured_for(cfg: DictConfig, run: SampledRun) -> DictConfig:
    """Return a copy of a configuration with the method, its options and the budget of a run."""
    cfg = cfg.copy()
    cfg.method = cfg.study.methods[run.method]
    cfg.method.method = OmegaConf.merge(cfg.method.method, run.options)
    if run.budget is not None:
        cfg.budget = cfg.study.budgets[run.budget]
    cfg.budget.iterations = max(1, round(int(cfg.budget.iterations) * run.share))
    return cfg


def sample_all(cfg: DictConfig) -> tuple[pd.DataFrame, int]:
    """Return the curves of all scenes and runs, and the number of failed runs; these do not stop the others."""
    pool.set_threads(cfg.threads)
    torch.set_num_threads(1)
    curves, failed = [], 0
    for scene in cfg.study.scenes:
        for run in runs_of(cfg):
            try:
                curve = sample_curve(cfg, scene, run, int(cfg.study.samples))
            except Exception as error:
                failed += 1
                say(f"{', '.join(filter(None, (scene, run.label)))}: {error_message(error)}", "failed:")
                continue
            curves.append(curve)
            end = curve.iloc[-1]
            reached = f"{end.psnr:.2f} dB after {end.iteration} iterations and {end.seconds:.1f} s"
            say(f"{end.scene}, {run.label}: {reached}")
    columns = [
        "scene", "label", "iteration", "seconds", "processor_seconds", "busy", "gaussians", *CURVE_METRICS, IMAGES
    ]  # fmt: skip
    return (pd.concat(curves, ignore_index=True) if curves else pd.DataFrame(columns=columns)), failed


def sample_curve(cfg: DictConfig, scene_name: str | None, run: SampledRun, samples: int) -> pd.DataFrame:
    """Train once and score the test views at `samples` iterations, evenly spaced on a logarithmic scale, and at the
    end, which may come before the budget's.

    A sample right after density control waits until the models have recovered, so that each point of the curve is a
    model as it would be saved. The clock stops while views are scored.
    """
    cfg = configured_for(cfg, run)
    cfg.scene = scene_name
    skips: Skips = instantiate(cfg.skip)
    scene: Scene = instantiate(loader_of(cfg, skips)).load(scene_name)
    priors = prior_cache(Path(cfg.results))
    trainer, scene, response = set_up(cfg, scene, skips=skips, prior_cache=priors)
    scorer: Scorer = instantiate(cfg.metrics)
    values, backend = _values_of(scene), training_backend(cfg.backend.name)
    sampled = _sampled_iterations(trainer.whole_context.budget, samples)
    rows: list[dict[str, Any]] = []

    def sample(log: TrainingLog) -> None:
        if log.iterations not in sampled and not log.ended:
            return
        scores = mean_scores(score_views(trainer, scene, scorer, response))
        rows.append(
            {
                "scene": scene.name,
                "label": run.label,
                "iteration": log.iterations,
                "seconds": log.seconds,
                "processor_seconds": log.processor_seconds,
                "busy": wall_by_processor_time(log.seconds, log.processor_seconds, backend) > BUSY,
                "gaussians": sum(len(model) for model in trainer.gaussians.values()),
                **{m: scores[m] for m in CURVE_METRICS},
                IMAGES: values,
            }
        )

    train(trainer, before_update=sample)
    return pd.DataFrame(rows)


def _values_of(scene: Scene) -> str:
    """Return `image_values` of scores on a scene."""
    record = Record("", scene.dataset, scene.name, "", 0, "", "", channels=scene.channels)  # type: ignore[arg-type]
    state_assumptions(record, scene)
    state_values(record, scene)
    return image_values([record])


def _sampled_iterations(budget: Budget, samples: int) -> set[int]:
    """Return the iterations to sample: logarithmically spaced, each moved on until the models have recovered."""
    end, rules = budget.iterations, budget.density
    even = np.geomspace(min(20, end), end, samples).round().astype(int)
    return {next(i for i in range(first, end + 1) if rules.has_recovered(i, end)) for first in even}


def faster_by(curves: pd.DataFrame, baseline: str, labels: list[str]) -> pd.DataFrame:
    """Return the share of time saved against the baseline over whole runs, at equal iterations and at equal quality.

    The gain in dB is at equal time, the end of the shorter run. A run that failed has no row; what depends on times is
    NaN where other work took processor time from one of the two.
    """
    rows = []
    for scene, group in curves.groupby("scene", sort=False):
        by_label = {str(label): curve for label, curve in group.groupby("label", sort=False)}
        for label in labels:
            if baseline not in by_label or label not in by_label:
                continue
            pair = by_label[label], by_label[baseline]
            ends = [float(curve["seconds"].iloc[-1]) for curve in pair]
            last = min(int(curve["iteration"].iloc[-1]) for curve in pair)
            per_iteration = [float(np.interp(last, curve["iteration"], curve["seconds"])) for curve in pair]
            quality = min(float(curve["psnr"].max()) for curve in pair)
            reached = [first_at(curve, quality, "seconds", "psnr") for curve in pair]
            there = [float(np.interp(min(ends), curve["seconds"], curve["psnr"], left=np.nan)) for curve in pair]
            known = np.nan if any(curve["busy"].iloc[-1] for curve in pair) else 1.0
            rows.append(
                {
                    "scene": scene,
                    "label": label,
                    "baseline": baseline,
                    "whole runs": known * (1 - ends[0] / ends[1]),
                    "equal iterations": known * (1 - per_iteration[0] / per_iteration[1]),
                    "equal quality": known * (1 - reached[0] / reached[1]),
                    "that quality (dB)": quality,
                    "dB more at equal time": known * (there[0] - there[1]),
                    IMAGES: group[IMAGES].iloc[0],
                }
            )
    return pd.DataFrame(rows)


def best_after(curves: pd.DataFrame, times: Sequence[float]) -> pd.DataFrame:
    """Return the best PSNR, SSIM and LPIPS that the samples of each curve have after each of these times, seconds.

    Scores are NaN where no sample is that early. ended: whether the training was over by then, so that they are final.
    """
    rows = []
    for names, curve in curves.groupby(["scene", "seed", "label"], sort=False):
        for seconds in times:
            so_far = curve[curve["seconds"] <= seconds]
            best = {"psnr": so_far["psnr"].max(), "ssim": so_far["ssim"].max(), "lpips": so_far["lpips"].min()}
            ended = float(curve["seconds"].iloc[-1]) <= seconds
            place = dict(zip(("scene", "seed", "label"), names, strict=True))
            rows.append({**place, "after": seconds, **best, "ended": ended, IMAGES: curve[IMAGES].iloc[0]})
    return pd.DataFrame(rows)


def draw_curves(curves: pd.DataFrame, target: Path) -> None:
    """Draw the quality of the test views against seconds of training: one column per scene, one row per metric."""
    shown = [m for m in CURVE_METRICS if curves[m].notna().any()]
    scenes = list(dict.fromkeys(curves["scene"]))
    figure = Figure(figsize=(5.2 * len(scenes), 2.6 * len(shown)), layout="constrained")
    grid = figure.subplots(len(shown), len(scenes), squeeze=False)
    for column, scene in enumerate(scenes):
        for row, metric in enumerate(shown):
            axes = grid[row][column]
            for i, (label, curve) in enumerate(curves[curves["scene"] == scene].groupby("label", sort=False)):
                values, marker = curve[metric].astype(float), MARKERS[i % len(MARKERS)]
                axes.plot(curve["seconds"], values, marker=marker, markersize=3, linewidth=1, label=plain(str(label)))
            axes.set_xscale("log")
            axes.set_ylabel(METRICS[metric].title)
            axes.grid(linewidth=0.3)
        grid[0][column].set_title(plain(str(scene)), fontsize=9)
        grid[0][column].legend(fontsize=6)
        grid[-1][column].set_xlabel("seconds of training")
    save_figure(figure, target)
