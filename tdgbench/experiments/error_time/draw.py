"""Pictures of the error-time experiment: Pareto plot, training curves, growth of cost."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tdgbench.experiments.error_time import growth, training
from tdgbench.report.figures import plain, save_figure
from tdgbench.scoring import METRICS

MARKERS = "osD^vP*X"
DRAWN_ZERO = 1e-9  # an error of zero is drawn here


def draw_pareto(table: pd.DataFrame, target: Path) -> None:
    """Time against error, logarithmic, one panel per scene; non-dominated settings are joined and named."""
    scenes = list(dict.fromkeys(table["scene"]))
    settings = list(dict.fromkeys(table["setting"]))
    figure = Figure(figsize=(5 * len(scenes) + 2.4, 4.6), layout="constrained")
    grid = figure.subplots(1, len(scenes), squeeze=False)[0]
    for axes, scene in zip(grid, scenes, strict=True):
        rows = table[table["scene"] == scene].assign(error=lambda t: t["gradient_error"].clip(lower=DRAWN_ZERO))
        front = rows[rows["non_dominated"]].sort_values("both_ms")
        axes.plot(front["both_ms"], front["error"], color="tab:red", linewidth=1, zorder=1)
        for i, setting in enumerate(settings):
            point = rows[rows["setting"] == setting]
            axes.scatter(point["both_ms"], point["error"], s=26, marker=MARKERS[i % len(MARKERS)],
                         color=f"C{i % 10}", label=plain(str(setting)), zorder=2)  # fmt: skip
        for row in front.itertuples():
            axes.annotate(row.setting, (row.both_ms, row.error), fontsize=7, xytext=(4, 4), textcoords="offset points")
        _logarithmic(axes, "forward + backward, ms", f"error of the gradients (0 is drawn at {DRAWN_ZERO:g})")
        axes.set_title(plain(str(scene)), fontsize=9)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", fontsize=7)
    save_figure(figure, target)


def draw_curves(curves: pd.DataFrame, target: Path) -> None:
    """Quality of the test views against seconds of training: one column per scene, one row per metric."""
    shown = [m for m in training.METRICS if curves[m].notna().any()]
    scenes = list(dict.fromkeys(curves["scene"]))
    figure = Figure(figsize=(5.2 * len(scenes), 2.6 * len(shown)), layout="constrained")
    grid = figure.subplots(len(shown), len(scenes), squeeze=False)
    for column, scene in enumerate(scenes):
        for row, metric in enumerate(shown):
            axes: Axes = grid[row][column]
            for i, (label, curve) in enumerate(curves[curves["scene"] == scene].groupby("label", sort=False)):
                axes.plot(curve["seconds"], curve[metric].astype(float), marker=MARKERS[i % len(MARKERS)], markersize=3,
                          linewidth=1, label=plain(str(label)))  # fmt: skip
            axes.set_xscale("log")
            axes.set_ylabel(METRICS[metric].title)
            axes.grid(linewidth=0.3)
            if row == 0:
                axes.set_title(plain(str(scene)), fontsize=9)
                axes.legend(fontsize=6)
        grid[-1][column].set_xlabel("seconds of training")
    save_figure(figure, target)


def draw_growth(table: pd.DataFrame, fitted: pd.DataFrame, target: Path) -> None:
    """Time and memory against size, one panel per axis."""
    figure = Figure(figsize=(3.4 * len(growth.AXES), 3), layout="constrained")
    slopes = fitted.set_index("axis")
    for axes, axis in zip(figure.subplots(1, len(growth.AXES)), growth.AXES, strict=True):
        rows = table[table["axis"] == axis]
        axes.plot(rows["size"], rows["ms"], "o-", label=f"ms, exponent {slopes.loc[axis, 'time']:.2f}")
        axes.plot(rows["size"], rows["memory_mb"], "s--", label=f"MB, exponent {slopes.loc[axis, 'memory']:.2f}")
        _logarithmic(axes, axis, "")
        axes.legend(fontsize=7)
    save_figure(figure, target)


def _logarithmic(axes: Axes, x: str, y: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(linewidth=0.3)
