"""`+experiment=skips`: what each skip saves and costs, alone and together; its cells have the skip on and off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from omegaconf import DictConfig

from tdgbench.bench.options import OptionError
from tdgbench.bench.signature import Problem
from tdgbench.cells.record import Record
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
)
from tdgbench.tables.likeness import was_disturbed
from tdgbench.tables.palette import IMAGES
from tdgbench.tables.show import format_columns, show_table
from tdgbench.training.budget import SKIP_RULES as RULES
from tdgbench.training.skips import SWITCHES, no_such_skip

NAMES = (*SWITCHES, *RULES)
NONE, ALL, ALONE, WITHOUT = "none", "all", "only {}", "without {}"  # variants
PLACE = ("scene", "seed")
TAKEN = "taken"  # column of the names of a cell's skips that were taken, which no file has
NOWHERE, NA, UNDECIDED = "none", "n/a", "undecided"  # of `taken_on`; verdicts
TOGETHER = "all together"  # the row of the variant ALL
MAX_LOSS = {"psnr": 0.05, "ssim": 0.001}  # on any scene, of a skip that is on by default
BEFORE = ("load", "images", "thermal_camera", "prior", "init", "compile", "rig")  # training
_SHOWN = {  # on the terminal: title, format
    "skip": ("skip", "{}"), "taken_on": ("taken on", "{}"), "faster_alone": ("faster alone", "{:.2f} ×"),
    "slower_without": ("slower without", "{:.2f} ×"), "psnr_worst": ("worst PSNR, dB", "{:+.3f}"),
    "psnr_error": ("±", "{:.3f}"), "ssim_worst": ("worst SSIM", "{:+.4f}"), "ssim_error": (" ±", "{:.4f}"),
    "default_may_be": ("default may be", "{}"),
}  # fmt: skip


@dataclass(frozen=True)
class SkipAblationOptions(MatrixOptions):
    """Options in `cfg.study`: what to run; skips outside of `skips` are off in all cells."""

    skips: list[str]


class SkipAblation(Matrix):
    """Cells with each skip alone, with all but one, with all and with none."""

    options = SkipAblationOptions
    missing: ClassVar[str] = ""

    def start(self, cfg: DictConfig) -> None:
        prepare_prior(cfg)

    def axes(self, cfg: DictConfig) -> Axes:
        """Return scenes, seeds, variants; each variant switches all skips on or off. Off is null for a rule."""
        usual = {name: bool(cfg.skip.get(name, True)) for name in SWITCHES}
        usual |= {name: cfg.budget.get(name) is not None for name in RULES}
        if absent := [name for name in cfg.study.skips if name in RULES and not usual[name]]:
            what = f"the budget has no rule {', '.join(absent)}; `budget=lean` has most"
            raise OptionError([Problem("study.skips", what)])
        switched = []
        for label, skips in variants(list(cfg.study.skips), usual).items():
            changes: dict[str, Any] = {f"skip.{name}": skips[name] for name in SWITCHES}
            changes |= {f"budget.{name}": None for name in RULES if not skips[name]}
            switched.append(AxisValue(label, changes, label))
        scenes, seeds = values_of("scene", cfg.study.scenes), values_of("seed", cfg.study.seeds)
        return {"scene": scenes, "seed": seeds, "variant": switched}

    def tables(self, cfg: DictConfig, cells: Sequence[MatrixCell]) -> dict[str, pd.DataFrame]:
        rows = with_changes(table_of(cells, numbers))
        if rows.empty:
            return {}
        names = {cell.labels["scene"]: cell.record.scene for cell in cells if cell.record is not None}
        asked = [(names.get(cell.labels["scene"], cell.labels["scene"]), cell.labels["seed"]) for cell in cells]
        places = pd.MultiIndex.from_tuples(dict.fromkeys(asked), names=PLACE)
        table = summary(rows, list(cfg.study.skips), places).assign(**{IMAGES: self.image_values(cells)})
        return {"skips": table, "skips_cells": rows.drop(columns=TAKEN)}

    def show(self, table: pd.DataFrame) -> None:
        show_table(format_columns(table, _SHOWN))


def variants(names: Sequence[str], usual: Mapping[str, bool]) -> dict[str, dict[str, bool]]:
    """Return the skips that each variant allows, by label; skips outside of `names` are off in all variants.

    usual: whether each skip is on by default. The variant `all` has those of `names` that are on by default, and only
    these have a variant without them. Raises OptionError for an unknown name.

    >>> list(variants(["gray"], dict.fromkeys(NAMES, True)))
    ['none', 'all', 'only gray', 'without gray']
    """
    if what := no_such_skip(names, NAMES):
        raise OptionError([Problem("study.skips", what)])
    together = {name: name in names and usual[name] for name in NAMES}
    choices = {NONE: dict.fromkeys(NAMES, False), ALL: together}
    for name in names:
        choices[ALONE.format(name)] = {**choices[NONE], name: True}
        if usual[name]:
            choices[WITHOUT.format(name)] = {**together, name: False}
    return choices


def numbers(record: Record) -> dict[str, Any]:
    """Return the numbers of a cell: seconds of training and before it, memory, scores, skipped work with reasons."""
    taken = [skip for skip in record.skips if skip["taken"]]
    seconds = np.nan if was_disturbed(record) else record.seconds.get("train", np.nan)
    return {
        "train_seconds": seconds,
        "seconds_before": sum(record.seconds.get(phase, 0.0) for phase in BEFORE),
        "iterations": record.iterations,
        "gaussians": sum(record.gaussians.values()),
        "peak_rss_mb": record.peak_rss_mb,
        **{metric: record.scores.get(metric) for metric in QUALITY},
        TAKEN: frozenset(skip["name"] for skip in taken),
        "left_out": "; ".join(f"{skip['name']}: {skip['saved']} ({skip['reason']})" for skip in taken),
    }


def with_changes(table: pd.DataFrame) -> pd.DataFrame:
    """Add columns `change of …` to the cells: against the cell of the same scene and seed that has every skip off."""
    if table.empty:
        return table
    base = table[table["variant"] == NONE].set_index(["scene", "seed"])
    places = list(zip(table["scene"], table["seed"], strict=True))
    against = base.reindex(places)[list(QUALITY)].apply(pd.to_numeric)
    changes = {f"change of {m}": pd.to_numeric(table[m]) - against[m].to_numpy() for m in QUALITY}
    return table.drop(columns=IMAGES).assign(**changes, **{IMAGES: table[IMAGES]})  # the last one, as in all tables


def summary(table: pd.DataFrame, names: Sequence[str], places: pd.MultiIndex) -> pd.DataFrame:
    """Return one row per skip, and one for all together. places: scenes and seeds of the trainings, also failed ones.

    faster_alone: training time with no skip over that with this one. slower_without: training time with all but this
    one over that with all. psnr_worst, ssim_worst: change by this skip alone, against no skip, on the scene where it
    is worst (mean over seeds). psnr_error, ssim_error: standard error of that mean (NaN for one seed). default_may_be:
    `on` if no scene loses more than MAX_LOSS, `off` if one does, each by two standard errors; else, also where one seed
    has a change, `undecided`. All of these are n/a if a cell is missing; ratios and `default_may_be`, also where the
    skip was not taken: a ratio of equal trainings is noise.
    """
    rows = []
    for name, variant in (*((name, ALONE.format(name)) for name in names), (TOGETHER, ALL)):
        psnr, psnr_error, of_psnr = _worst(table, variant, "psnr", places)
        ssim, ssim_error, of_ssim = _worst(table, variant, "ssim", places)
        taken = "" if variant == ALL else _taken(table, variant, name)
        is_none = taken == NOWHERE or (variant == ALL and not any(table.loc[table["variant"] == ALL, TAKEN]))
        verdict = next((one for one in (NA, "off", UNDECIDED) if one in (of_psnr, of_ssim)), "on")
        rows.append(
            {
                "skip": name, "taken_on": taken, **{f"{axis}s": places.unique(axis).size for axis in PLACE},
                "faster_alone": np.nan if is_none else _ratio(table, NONE, variant, places),
                "slower_without": np.nan if is_none else _ratio(table, WITHOUT.format(name), ALL, places),
                "memory_alone": np.nan if is_none else _ratio(table, NONE, variant, places, "peak_rss_mb"),
                "psnr_worst": psnr, "psnr_error": psnr_error, "ssim_worst": ssim, "ssim_error": ssim_error,
                "default_may_be": NA if is_none else verdict,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def _worst(table: pd.DataFrame, variant: str, metric: str, places: pd.MultiIndex) -> tuple[float, float, str]:
    """Return a metric's change on the worst scene, its standard error, and whether all scenes lose at most MAX_LOSS.

    places: scenes and seeds that all must have a change.
    """
    rows = table[(table["variant"] == variant) & table[f"change of {metric}"].notna()]
    if {*zip(rows["scene"], rows["seed"], strict=True)} != {*places}:
        return float("nan"), float("nan"), NA
    by_scene = rows.groupby("scene")[f"change of {metric}"]
    mean, error, least = by_scene.mean(), by_scene.sem(), -MAX_LOSS[metric]
    unsure = 2 * error.where((error.notna()) | (mean != 0), 0.0)  # one seed without any change has no error
    verdict = "on" if (mean - unsure >= least).all() else "off" if (mean + unsure < least).any() else UNDECIDED
    return float(mean.min()), float(error[mean.idxmin()]), verdict


def _ratio(table: pd.DataFrame, slow: str, fast: str, places: pd.MultiIndex, column: str = "train_seconds") -> float:
    """Return the geometric mean over scenes and seeds of slow / fast; NaN if a cell of a variant has no number."""
    both = table.pivot_table(index=list(PLACE), columns="variant", values=column, dropna=False).reindex(places)
    if slow not in both or fast not in both:
        return float("nan")
    return float(np.exp(np.log(both[slow] / both[fast]).mean(skipna=False)))


def _taken(table: pd.DataFrame, variant: str, name: str) -> str:
    """Name the scenes on which the skip was taken."""
    cells = table[table["variant"] == variant]
    taken = cells[[name in names for names in cells[TAKEN]]]
    return ", ".join(dict.fromkeys(taken["scene"])) or NOWHERE
