"""Training: quality of the test views against wall time, and what each step from MSMG to TDg adds to the speed-up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.scores import score_views
from tdgbench.bench.setup import loader_of, set_up
from tdgbench.scenes import Scene
from tdgbench.scoring import Scorer, mean_scores
from tdgbench.training.budget import Budget
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Method
from tdgbench.training.skips import Skips

METRICS = ("psnr", "ssim", "lpips", "depth_abs_rel")


@dataclass(frozen=True)
class Run:
    """A link of the chain: a method, overrides of its options, and its share of the budget's iterations.

    budget: its name in `job.budgets`; None: that of the configuration.
    """

    label: str
    method: str
    share: float
    options: Mapping[str, Any]
    budget: str | None = None


def runs_of(cfg: DictConfig) -> list[Run]:
    """The chain in `cfg.job.runs`. Raises ValueError for a method or budget that is not in `cfg.job`."""
    runs: list[Run] = []
    for one in cfg.job.runs:
        budget = one.get("budget")
        if one.method not in cfg.job.methods:
            raise ValueError(f"run {one.label!r}: no method {one.method!r} among {', '.join(cfg.job.methods)}")
        if budget is not None and budget not in cfg.job.get("budgets", {}):
            raise ValueError(f"run {one.label!r}: no budget {budget!r} among {', '.join(cfg.job.get('budgets', {}))}")
        if one.label in [run.label for run in runs]:
            raise ValueError(f"two runs have the label {one.label!r} in job.runs")
        runs.append(Run(one.label, one.method, float(one.get("share", 1.0)), dict(one.get("options", {})), budget))
    return runs


def sample_curve(cfg: DictConfig, scene_name: str | None, run: Run, samples: int) -> pd.DataFrame:
    """Train one link and score the test views at `samples` iterations, evenly spaced on a logarithmic scale, and at the
    end, which may come before the budget's.

    A sample right after density control waits until the models have recovered, so that each point of the curve is a
    model as it would be saved. The clock stops while views are scored.
    """
    cfg = cfg.copy()
    cfg.scene, cfg.method = scene_name, cfg.job.methods[run.method]
    if run.budget is not None:
        cfg.budget = cfg.job.budgets[run.budget]
    skips: Skips = instantiate(cfg.skip)
    scene: Scene = instantiate(loader_of(cfg, skips)).load(scene_name)
    cfg.budget.iterations = max(1, round(int(cfg.budget.iterations) * run.share))
    unready: Method = instantiate(OmegaConf.merge(cfg.job.methods[run.method].method, dict(run.options)))
    trainer, scene, response = set_up(cfg, scene, method=unready, skips=skips)
    scorer: Scorer = instantiate(cfg.metrics)
    sampled = _sampled_iterations(trainer.whole.budget, samples)
    rows: list[dict[str, Any]] = []

    def sample(log: TrainingLog) -> None:
        if log.iterations not in sampled and not log.ended:
            return
        scores = mean_scores(score_views(trainer, scene, scorer, response))
        gaussians = sum(len(model) for model in trainer.gaussians.values())
        rows.append(
            {
                "scene": scene.name, "label": run.label, "iteration": log.iterations,
                "seconds": log.seconds, "processor_seconds": log.processor_seconds, "gaussians": gaussians,
                **{m: scores[m] for m in METRICS},
            }
        )  # fmt: skip

    train(trainer, on_model=sample)
    return pd.DataFrame(rows)


def _sampled_iterations(budget: Budget, samples: int) -> set[int]:
    """Iterations to sample: evenly spaced on a logarithmic scale, each moved on until the models have recovered."""
    end, rules = budget.iterations, budget.density
    even = np.geomspace(min(20, end), end, samples).round().astype(int)
    return {next(i for i in range(first, end + 1) if rules.has_recovered(i, end)) for first in even}


def seconds_to(curve: pd.DataFrame, quality: float, metric: str = "psnr") -> float:
    """Seconds until a curve first reaches a quality, linear between samples; NaN if it never does.

    >>> seconds_to(pd.DataFrame({"seconds": [1.0, 2.0], "psnr": [20.0, 24.0]}), 22.0)
    1.5
    """
    seconds, values = curve["seconds"].to_numpy(float), curve[metric].to_numpy(float)
    for i, value in enumerate(values):
        if value >= quality:
            if i == 0:
                return float(seconds[0])
            share = (quality - values[i - 1]) / (value - values[i - 1])
            return float(seconds[i - 1] + share * (seconds[i] - seconds[i - 1]))
    return math.nan


def quality_at(curve: pd.DataFrame, seconds: float, metric: str = "psnr") -> float:
    """Quality of a curve at a time, linear between samples; NaN before the first sample, constant after the last.

    >>> quality_at(pd.DataFrame({"seconds": [1.0, 2.0], "psnr": [20.0, 24.0]}), 1.5)
    22.0
    """
    times = curve["seconds"].to_numpy(float)
    if seconds < times[0]:
        return math.nan
    return float(np.interp(seconds, times, curve[metric].to_numpy(float)))


def milestones(curves: pd.DataFrame) -> pd.DataFrame:
    """One row per scene and label: final quality and time, seconds to whole dB, dB at the end of each other run."""
    rows = []
    for scene, group in curves.groupby("scene", sort=False):
        by_label = {str(label): curve for label, curve in group.groupby("label", sort=False)}
        ends = {label: float(curve["seconds"].iloc[-1]) for label, curve in by_label.items()}
        best = min(float(curve["psnr"].max()) for curve in by_label.values())
        levels = range(math.floor(best) - 4, math.floor(best) + 1)
        for label, curve in by_label.items():
            row = {"scene": scene, "label": label, "end_seconds": ends[label], "end_psnr": curve["psnr"].iloc[-1]}
            row |= {f"seconds to {level} dB": seconds_to(curve, level) for level in levels}
            row |= {f"dB at {end:.1f} s ({other})": quality_at(curve, end) for other, end in ends.items()}
            rows.append(row)
    return pd.DataFrame(rows)


def attribution(curves: pd.DataFrame, labels: list[str]) -> pd.DataFrame:
    """Contribution of each link to the speed-up from the first label to the last, per scene.

    factor: time of the previous link over that of this one. share: of the logarithm of the total factor, so that
    shares add up to 1. saved: share of time saved against the first link, as the paper counts it.
    """
    rows = []
    for scene, group in curves.groupby("scene", sort=False):
        ends = {str(label): float(curve["seconds"].iloc[-1]) for label, curve in group.groupby("label", sort=False)}
        if any(label not in ends for label in labels):
            continue  # a run failed: the chain is broken
        whole = math.log(ends[labels[0]] / ends[labels[-1]])
        for before, label in itertools.pairwise(labels):
            factor = ends[before] / ends[label]
            saved = 1 - ends[label] / ends[labels[0]]
            rows.append(
                {"scene": scene, "step": label, "factor": factor, "share": math.log(factor) / whole, "saved": saved}
            )  # fmt: skip
    return pd.DataFrame(rows, columns=["scene", "step", "factor", "share", "saved"])


def faster_by(curves: pd.DataFrame, baseline: str, labels: list[str]) -> pd.DataFrame:
    """Share of time saved against the baseline over whole runs, at equal iterations and at equal quality.

    Also the gain in dB at equal time, the end of the shorter run.
    """
    rows = []
    for scene, group in curves.groupby("scene", sort=False):
        by_label = {str(label): curve for label, curve in group.groupby("label", sort=False)}
        if baseline not in by_label:
            continue
        base = by_label[baseline]
        for label in labels:
            if label not in by_label:
                continue
            curve = by_label[label]
            end, base_end = float(curve["seconds"].iloc[-1]), float(base["seconds"].iloc[-1])
            last = int(min(curve["iteration"].iloc[-1], base["iteration"].iloc[-1]))
            per_iteration = [float(np.interp(last, c["iteration"], c["seconds"])) for c in (curve, base)]
            quality = float(min(curve["psnr"].max(), base["psnr"].max()))
            reached = [seconds_to(c, quality) for c in (curve, base)]
            at = min(end, base_end)
            rows.append(
                {
                    "scene": scene, "label": label, "whole runs": 1 - end / base_end,
                    "equal iterations": 1 - per_iteration[0] / per_iteration[1],
                    "equal quality": 1 - reached[0] / reached[1], "that quality (dB)": quality,
                    "dB more at equal time": quality_at(curve, at) - quality_at(base, at),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def sample_all(
    cfg: DictConfig, report: Callable[[str, str, pd.DataFrame | Exception], None]
) -> tuple[pd.DataFrame, int]:
    """Curves of all scenes and links, and the number of failed runs; a failed run does not stop the others."""
    parts, failed = [], 0
    for scene in cfg.job.scenes:
        for run in runs_of(cfg):
            try:
                curve = sample_curve(cfg, scene, run, int(cfg.job.samples))
            except Exception as error:
                failed += 1
                report(str(scene), run.label, error)
                continue
            parts.append(curve)
            report(str(curve["scene"].iloc[0]), run.label, curve)
    columns = ["scene", "label", "iteration", "seconds", "processor_seconds", "gaussians", *METRICS]
    return (pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)), failed
