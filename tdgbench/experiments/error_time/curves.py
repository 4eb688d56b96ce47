"""Curves of the test views' quality against the seconds of training: comparisons, and their figure."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tdgbench.report.figures import plain, save_figure
from tdgbench.scoring import METRICS

CURVE_METRICS = ("psnr", "ssim", "lpips", "depth_abs_rel")
MARKERS = "osD^vP*X"


def seconds_to(curve: pd.DataFrame, quality: float, metric: str = "psnr") -> float:
    """Return the seconds until a curve first reaches a quality, linear between samples; NaN if it never does.

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
    """Return the quality of a curve at a time, linear between samples; NaN before the first, constant after the last.

    >>> quality_at(pd.DataFrame({"seconds": [1.0, 2.0], "psnr": [20.0, 24.0]}), 1.5)
    22.0
    """
    times = curve["seconds"].to_numpy(float)
    if seconds < times[0]:
        return math.nan
    return float(np.interp(seconds, times, curve[metric].to_numpy(float)))


def attribution(curves: pd.DataFrame, labels: list[str]) -> pd.DataFrame:
    """Return the contribution of each link to the speed-up from the first label to the last, per scene.

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
            share = math.log(factor) / whole
            rows.append({"scene": scene, "step": label, "factor": factor, "share": share, "saved": saved})
    return pd.DataFrame(rows, columns=["scene", "step", "factor", "share", "saved"])


def faster_by(curves: pd.DataFrame, baseline: str, labels: list[str]) -> pd.DataFrame:
    """Return the share of time saved against the baseline over whole runs, at equal iterations and at equal quality.

    The gain in dB is at equal time, the end of the shorter run.
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
                    "scene": scene,
                    "label": label,
                    "whole runs": 1 - end / base_end,
                    "equal iterations": 1 - per_iteration[0] / per_iteration[1],
                    "equal quality": 1 - reached[0] / reached[1],
                    "that quality (dB)": quality,
                    "dB more at equal time": quality_at(curve, at) - quality_at(base, at),
                }
            )
    return pd.DataFrame(rows)


def draw_curves(curves: pd.DataFrame, target: Path) -> None:
    """Draw the quality of the test views against seconds of training: one column per scene, one row per metric."""
    shown = [m for m in CURVE_METRICS if curves[m].notna().any()]
    scenes = list(dict.fromkeys(curves["scene"]))
    figure = Figure(figsize=(5.2 * len(scenes), 2.6 * len(shown)), layout="constrained")
    grid = figure.subplots(len(shown), len(scenes), squeeze=False)
    for column, scene in enumerate(scenes):
        for row, metric in enumerate(shown):
            axes: Axes = grid[row][column]
            for i, (label, curve) in enumerate(curves[curves["scene"] == scene].groupby("label", sort=False)):
                values, marker = curve[metric].astype(float), MARKERS[i % len(MARKERS)]
                axes.plot(curve["seconds"], values, marker=marker, markersize=3, linewidth=1, label=plain(str(label)))
            axes.set_xscale("log")
            axes.set_ylabel(METRICS[metric].title)
            axes.grid(linewidth=0.3)
            if row == 0:
                axes.set_title(plain(str(scene)), fontsize=9)
                axes.legend(fontsize=6)
        grid[-1][column].set_xlabel("seconds of training")
    save_figure(figure, target)
