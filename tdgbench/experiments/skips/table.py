"""What each skip saved and cost: per cell, and summarised over scenes."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tdgbench.bench.record import Record
from tdgbench.experiments.skips.variants import ALL, NONE, alone, without

MAX_LOSS = {"psnr": 0.05, "ssim": 0.001}  # on any scene, of a skip that is on by default
QUALITY = ("psnr", "ssim", "lpips")


def skip_rows(records: list[Record]) -> pd.DataFrame:
    """One row per finished cell: seconds of training and before it, memory, scores, skipped work with reasons.

    `change of …` compares with the cell of the same scene and seed that has every skip off.
    """
    rows = []
    for record in records:
        before = sum(record.seconds.get(stage, 0.0) for stage in ("load", "images", "prior", "init"))
        taken = [skip for skip in record.skips if skip["taken"]]
        rows.append(
            {
                "scene": record.scene,
                "seed": record.seed,
                "variant": record.variant,
                "train_seconds": record.seconds["train"],
                "seconds_before": before,
                "iterations": record.iterations,
                "gaussians": sum(record.gaussians.values()),
                "peak_rss_mb": record.peak_rss_mb,
                **{metric: record.scores.get(metric) for metric in QUALITY},
                "left_out": "; ".join(f"{skip['name']}: {skip['saved']} ({skip['reason']})" for skip in taken),
            }
        )
    table = pd.DataFrame(rows)
    if table.empty:
        return table
    base = table[table["variant"] == NONE].set_index(["scene", "seed"])
    for metric in QUALITY:
        against = [base[metric].get((r.scene, r.seed), np.nan) for r in table.itertuples()]
        table[f"change of {metric}"] = pd.to_numeric(table[metric]) - pd.to_numeric(pd.Series(against))
    return table.sort_values(["scene", "seed"], kind="stable").reset_index(drop=True)


def summary(table: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """One row per skip, and one for all together.

    faster_alone: training time with no skip over that with this one. slower_without: training time with all but this
    one over that with all. psnr_worst, ssim_worst: change by this skip alone, against no skip, on the scene where it
    is worst (mean over seeds). psnr_error, ssim_error: standard error of that mean (NaN for one seed). keep: whether
    the skip may be on by default, because no scene loses more than MAX_LOSS by more than two standard errors.
    """
    rows = []
    for name, on, off, without_it in (
        *((n, alone(n), NONE, without(n)) for n in names),
        ("all together", ALL, NONE, None),
    ):
        psnr, psnr_error, psnr_ok = _worst(table, on, "psnr")
        ssim, ssim_error, ssim_ok = _worst(table, on, "ssim")
        rows.append(
            {
                "skip": name,
                "taken_on": _taken(table, on, name),
                "faster_alone": _ratio(table, off, on),
                "slower_without": np.nan if without_it is None else _ratio(table, without_it, ALL),
                "memory_alone": _ratio(table, off, on, "peak_rss_mb"),
                "psnr_worst": psnr,
                "psnr_error": psnr_error,
                "ssim_worst": ssim,
                "ssim_error": ssim_error,
                "keep": psnr_ok and ssim_ok,
            }
        )
    return pd.DataFrame(rows)


def _worst(table: pd.DataFrame, variant: str, metric: str) -> tuple[float, float, bool]:
    """Change of a metric on the worst scene, its standard error, and whether every scene is within MAX_LOSS."""
    cells = table[table["variant"] == variant]
    by_scene = cells.assign(change=cells[f"change of {metric}"].astype(float)).groupby("scene")["change"]
    mean, error = by_scene.mean(), by_scene.sem()
    if mean.dropna().empty:
        return float("nan"), float("nan"), False
    acceptable = bool((mean + 2 * error.fillna(0.0) >= -MAX_LOSS[metric]).all())
    return float(mean.min()), float(error[mean.idxmin()]), acceptable


def _ratio(table: pd.DataFrame, slow: str, fast: str, column: str = "train_seconds") -> float:
    """Geometric mean over scenes and seeds of slow / fast; NaN if a variant has no cells."""
    both = table.pivot_table(index=["scene", "seed"], columns="variant", values=column)
    if slow not in both or fast not in both:
        return float("nan")
    return float(np.exp(np.log(both[slow] / both[fast]).mean()))


def _taken(table: pd.DataFrame, variant: str, name: str) -> str:
    """Scenes on which the skip was taken."""
    if name == "all together":
        return ""
    cells = table[table["variant"] == variant]
    taken = cells[cells["left_out"].str.contains(f"(?:^|; ){name}: ", regex=True)]
    return ", ".join(dict.fromkeys(taken["scene"])) or "none"
