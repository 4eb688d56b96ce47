"""`+experiment=capacity`: methods at equal numbers of Gaussians, and what each has reached after equal times.

The number is that of the set of Gaussians that renders thermal images: of MSMG its thermal model, beside which its RGB
model has as many again (`Budget.gaussians`). Trainings are as long as their budgets say, which tables show. Times are
of trainings whose number is free; test views choose the best scores, so that no training could know them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
from omegaconf import DictConfig
from pydantic import Field, PositiveFloat, PositiveInt

from tdgbench.cells.record import Record
from tdgbench.experiments.error_time import SampledRun, best_after, configured_for, runs_of, sample_all
from tdgbench.experiments.experiment import prepare_prior
from tdgbench.experiments.matrix import (
    QUALITY,
    Axes,
    AxisValue,
    Matrix,
    MatrixCell,
    MatrixOptions,
    table_of,
    values_of,
    write_tables,
)
from tdgbench.tables.claims.cell_pairs import gain_interval
from tdgbench.tables.claims.evidence import UNDECIDED
from tdgbench.tables.measures import measure_of
from tdgbench.tables.palette import IMAGES, IN_SOME
from tdgbench.tables.show import format_columns, show_table
from tdgbench.terminal import say

EVERY_SCENE = "all scenes"
UNEQUAL = "n/a: unequal numbers"
_SHOWN = {
    "scene": ("scene", "{}"), "gaussians": ("asked for", "{:,.0f}"), "run": ("run", "{}"), "had": ("Gaussians", "{}"),
    "iterations": ("iterations", "{}"), "processor_seconds": ("processor s", "{:.0f}"),
    "seeds": ("seeds", "{}"), "psnr": ("PSNR, dB", "{:.2f}"), "psnr_half": ("±", "{:.2f}"),
    "psnr_gain": ("{} better by, dB", "{:+.2f}"), "psnr_gain_half": (" ±", "{:.2f}"), "verdict": ("so {}", "{}"),
}  # fmt: skip


@dataclass(frozen=True)
class CapacityOptions(MatrixOptions):
    """Options in `cfg.study`. The first of `runs` is compared with each of the others."""

    methods: dict[str, Any]
    runs: Annotated[list[SampledRun], Field(min_length=2)]
    gaussians: list[PositiveInt]  # of the set that renders thermal images; empty: no cells of equal numbers
    times: list[PositiveFloat]  # seconds of training; empty: no curves
    samples: Annotated[int, Field(ge=2)]  # along a training, of its curve
    budgets: dict[str, Any] = field(default_factory=dict)


class Capacity(Matrix):
    """Runs at equal numbers of Gaussians; then their scores after equal times, with a free number."""

    options = CapacityOptions
    sets: ClassVar[Mapping[str, str]] = {
        **Matrix.sets,
        "method": "study.runs",
        "budget.gaussians": "study.gaussians=[NUMBER,...]",
    }

    def start(self, cfg: DictConfig) -> None:
        prepare_prior(cfg, [cfg.study.methods[run.method] for run in runs_of(cfg)])

    def axes(self, cfg: DictConfig) -> Axes:
        runs = []
        for run in runs_of(cfg):
            of_run = configured_for(cfg, run)
            changes = {"share": run.share, **run.options} if run.share != 1 else dict(run.options)
            changes |= {} if run.budget is None else {"budget": run.budget}
            variant = ",".join(f"{name}={value}" for name, value in changes.items())
            runs.append(AxisValue(run.label, {"method": of_run.method, "budget": of_run.budget}, variant))
        numbers = [AxisValue(n, {"budget.gaussians": n}, f"gaussians={n}") for n in cfg.study.gaussians]
        scenes, seeds = values_of("scene", cfg.study.scenes), values_of("seed", cfg.study.seeds)
        return {"scene": scenes, "seed": seeds, "run": runs, "gaussians": numbers}

    def tables(self, cfg: DictConfig, cells: Sequence[MatrixCell]) -> dict[str, pd.DataFrame]:
        rows = table_of(cells, numbers_at_size)
        if rows.empty:
            return {}
        first = runs_of(cfg)[0].label
        return {"capacity": at_equal_numbers(rows, first), "capacity_cells": rows}

    def show(self, table: pd.DataFrame) -> None:
        first = table["run"].iloc[0]
        shown = {name: (title.format(first), form) for name, (title, form) in _SHOWN.items()}
        show_table(
            format_columns(table, shown),
            "at equal numbers of Gaussians; 95 % intervals over seeds, of all scenes over scenes",
        )

    def run(self, cfg: DictConfig) -> None:
        """Run the cells; then sample the curves, if times are asked for. Raises SystemExit(1) if anything failed."""
        failed = False
        try:
            super().run(cfg)
        except SystemExit:
            failed = True
        if cfg.study.times:
            failed |= self._sample_times(cfg)
        if failed:
            raise SystemExit(1)

    def _sample_times(self, cfg: DictConfig) -> bool:
        """Write and print the scores after the times, each over all seeds; return whether a training failed."""
        sampled = []
        for seed in cfg.study.seeds:
            of_seed = cfg.copy()
            of_seed.seed = seed
            sampled.append(sample_all(of_seed))
        seeds, failed = cfg.study.seeds, any(broken for _, broken in sampled)
        curves = pd.concat([curve.assign(seed=seed) for (curve, _), seed in zip(sampled, seeds, strict=True)])
        if curves.empty:
            return failed
        times = over_seeds_of_times(best_after(curves, list(cfg.study.times)), len(seeds))
        write_tables(Path(cfg.results) / cfg.name, {"capacity_times": times, "capacity_curves": curves})
        columns = ("scene", "label", "after", "seeds", "psnr", "psnr_half", "ssim", "lpips", "ended")
        shown = {name: (name, "{:.4g}" if name not in ("scene", "label", "ended") else "{}") for name in columns}
        show_table(format_columns(times, shown), "best scores after equal times (s), 95 % intervals over seeds")
        say(f"tables: {Path(cfg.results) / cfg.name / 'capacity_times.csv'}")
        return failed


def numbers_at_size(record: Record) -> dict[str, Any]:
    """Return the numbers of a cell: the set that renders thermal images, all sets, training, scores."""
    return {
        "had": record.gaussians.get("thermal"),
        "of_all_sets": sum(record.gaussians.values()),
        "iterations": record.iterations,
        "train_seconds": record.seconds.get("train"),
        "processor_seconds": record.train_processor_seconds,  # of all threads; less than wall time depends on others
        **{metric: record.scores.get(metric) for metric in QUALITY},
    }


def at_equal_numbers(rows: pd.DataFrame, first: str) -> pd.DataFrame:
    """Return a row per scene, number and run, then one per number and run over all scenes.

    METRIC, METRIC_half: mean and half of its 95 % interval over seeds. METRIC_gain, _gain_half: by how much the first
    run is better, over the seeds with which both have one number of Gaussians. Over all scenes each scene counts once,
    and intervals are over scenes; there is no mean if a cell is missing that another run has, and no gain without equal
    numbers in each scene.
    verdict: of the first run against this one in PSNR: better or worse where the interval excludes 0, else undecided.
    """
    made = []
    for number, of_number in rows.groupby("gaussians", sort=False):
        scenes = list(dict.fromkeys(of_number["scene"]))
        for scene in [*scenes, *([EVERY_SCENE] if len(scenes) > 1 else [])]:
            there = of_number if scene == EVERY_SCENE else of_number[of_number["scene"] == scene]
            for label, group in there.groupby("run", sort=False):
                made.append({"scene": scene, "gaussians": number, "run": label, **_of_group(group, there, first)})
    return pd.DataFrame(made)


def _of_group(group: pd.DataFrame, there: pd.DataFrame, first: str) -> dict[str, Any]:
    """Return the columns of one row. group: the cells of its run. there: those of all runs, the first among them."""
    row: dict[str, Any] = {
        **{name: _span(group[name]) for name in ("had", "of_all_sets", "iterations")},
        **{name: pd.to_numeric(group[name]).mean() for name in ("train_seconds", "processor_seconds")},
        "seeds": group["seed"].nunique(),
    }
    is_first = group["run"].iloc[0] == first
    pairs = there[there["run"] == first].merge(group, on=["scene", "seed"], suffixes=("_first", ""))
    equal = pairs[(pairs["had_first"] == pairs["had"]) & (not is_first)]
    is_whole = len(equal) == len(group) and set(equal["scene"]) == set(there["scene"])
    pairs = equal if is_whole else equal[:0]  # of all seeds, and an average of all scenes
    has_all = there["scene"].nunique() == 1 or len(group) == len(there[["scene", "seed"]].drop_duplicates())
    for metric in QUALITY:
        sign = 1 if measure_of(metric).higher_is_better else -1
        row |= _mean(metric, group["scene"], pd.to_numeric(group[metric]), has_all)
        gains = sign * (pd.to_numeric(pairs[f"{metric}_first"]) - pd.to_numeric(pairs[metric]))
        row |= _mean(f"{metric}_gain", pairs["scene"], gains)
    gain, half = row["psnr_gain"], row["psnr_gain_half"]
    decided = UNDECIDED if not abs(gain) > half else "better" if gain > 0 else "worse"
    row["verdict"] = "" if is_first else decided if len(pairs) else UNEQUAL
    shown = set(group[IMAGES])
    return {**row, IMAGES: shown.pop() if len(shown) == 1 else IN_SOME}


def _mean(name: str, scenes: pd.Series, values: pd.Series, has_all: bool = True) -> dict[str, float]:
    """Return the mean of values and half of its 95 % interval, of which each scene is one of several; NaN: unknown.

    has_all: whether no cell is missing; else there is no mean.
    """
    known = values.notna()
    if not has_all or not known.any() or (scenes.nunique() > 1 and not known.all()):
        return {name: np.nan, f"{name}_half": np.nan}
    found = gain_interval([("", scene, nth) for nth, scene in enumerate(scenes[known])], values[known])
    return {name: found.mean, f"{name}_half": found.mean - found.low}


def _span(counts: pd.Series) -> str:
    """Return whole numbers as text: all of them are one, or lie from the least to the largest.

    >>> _span(pd.Series([5900, 6000])), _span(pd.Series([6000, 6000]))
    ('5900 to 6000', '6000')
    """
    return " to ".join(str(int(count)) for count in dict.fromkeys((counts.min(), counts.max())))


def over_seeds_of_times(times: pd.DataFrame, asked: int) -> pd.DataFrame:
    """Return one row per scene, run and time of `best_after`: means over seeds, with half of their 95 % intervals.

    asked: how many seeds were trained, also those that failed. seeds: those with a score by then; if one has none,
    there is no mean, which would be that of the fastest. ended: with how many seeds the training was over.
    """
    return pd.DataFrame(
        [
            {
                **dict(zip(("scene", "label", "after"), names, strict=True)),
                **{
                    k: v for metric in QUALITY
                    for k, v in _mean(metric, group["scene"], group[metric], group[metric].count() == asked).items()
                },
                "seeds": int(group["psnr"].notna().sum()), "ended": int(group["ended"].sum()),
                IMAGES: group[IMAGES].iloc[0],
            }
            for names, group in times.groupby(["scene", "label", "after"], sort=False)
        ]
    )  # fmt: skip
