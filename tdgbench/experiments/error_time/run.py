"""`+experiment=error_time`: tables on the terminal and as CSV, a Pareto plot, curves, and growth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tdgbench.experiments.error_time import growth, kernels, training
from tdgbench.experiments.measure.clouds import Cloud, random_cloud, trained_cloud
from tdgbench.files import write_text
from tdgbench.report.figures import save_figure
from tdgbench.splats.cpu import pool

PARTS = ("kernels", "training", "growth")
MARKERS = "osD^vP*X"
SHOWN = {
    "setting": "setting", "forward_ms": "fwd ms", "both_ms": "+ bwd ms", "both_ratio": "ratio", "image_error": "image",
    "depth_error": "depth", "gradient_error": "gradient", "non_dominated": "best",
}  # fmt: skip
NOTHING = 1e-9  # where an error of zero is drawn


def run(cfg: DictConfig) -> None:
    """Run the parts that a configuration asks for. Raises SystemExit(1) if a training failed, ValueError for a wrong
    part."""
    unknown = set(cfg.job.parts) - set(PARTS)
    if unknown:
        raise ValueError(f"job.parts: there is no {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    pool.set_threads(cfg.threads)
    torch.set_num_threads(1)
    console, folder = Console(), Path(cfg.results) / cfg.name
    folder.mkdir(parents=True, exist_ok=True)
    failed = 0
    if "kernels" in cfg.job.parts:
        _kernels(cfg, folder, console)
    if "training" in cfg.job.parts:
        failed = _training(cfg, folder, console)
    if "growth" in cfg.job.parts:
        _growth(cfg, folder, console)
    console.print(f"tables and pictures: {folder}", highlight=False, soft_wrap=True)
    if failed:
        raise SystemExit(1)


def _kernels(cfg: DictConfig, folder: Path, console: Console) -> None:
    job = cfg.job
    size = f"{job.width}×{job.height}"
    clouds: dict[str, Cloud] = {
        f"{count // 1000} k random, {size}": random_cloud(int(count), int(job.width), int(job.height))
        for count in job.counts
    }
    if job.model is not None:
        clouds["trained"] = trained_cloud(Path(job.model), Path(cfg.data.root))
    table = kernels.measure(clouds, int(job.repetitions), bool(job.slow))
    table["non_dominated"] = False
    for _, own in table.groupby("scene", sort=False):
        table.loc[own.index, "non_dominated"] = kernels.non_dominated(own, "both_ms", "gradient_error")
    _write(table, folder / "kernels.csv")
    for scene, own in table.groupby("scene", sort=False):
        _show(own[list(SHOWN)].rename(columns=SHOWN), console, f"{scene}: errors against float64")
    draw_pareto(table, folder / "pareto.png")


def _training(cfg: DictConfig, folder: Path, console: Console) -> int:
    def report(scene: str, label: str, result: pd.DataFrame | Exception) -> None:
        if isinstance(result, Exception):
            message = f"{scene}, {label}: {type(result).__name__}: {result}"
            console.print(f"[red]failed:[/red] {escape(message)}", highlight=False, soft_wrap=True)
            return
        last = result.iloc[-1]
        console.print(
            f"{scene}, {label}: {last.psnr:.2f} dB after {last.iteration} iterations and {last.seconds:.1f} s",
            highlight=False,
        )

    curves, failed = training.sample_all(cfg, report)
    labels = [one.label for one in training.runs_of(cfg)]
    _write(curves, folder / "curves.csv")
    if not curves.empty:
        tables = {
            "milestones": training.milestones(curves),
            "attribution": training.attribution(curves, labels),
            "faster": training.faster_by(curves, labels[0], labels[1:]),
        }
        titles = {
            "milestones": None,
            "attribution": f"what each step from {labels[0]} on contributes to the speed-up",
            "faster": f"time saved against {labels[0]}",
        }
        for name, table in tables.items():
            _write(table, folder / f"{name}.csv")
            title = titles[name]
            if title is not None:
                _show(table, console, title)
        draw_curves(curves, folder / "curves.png")
    return failed


def _growth(cfg: DictConfig, folder: Path, console: Console) -> None:
    job = cfg.job
    table = growth.measure(int(job.largest), int(job.width), int(job.height), int(job.repetitions))
    fitted = growth.exponents(table)
    _write(table, folder / "growth.csv")
    _write(fitted, folder / "growth_exponents.csv")
    _show(fitted, console, "cost ∝ size^exponent")
    draw_growth(table, fitted, folder / "growth.png")


def draw_pareto(table: pd.DataFrame, target: Path) -> None:
    """log time against log error, one panel per scene; the points that nothing beats are joined and named."""
    scenes = list(dict.fromkeys(table["scene"]))
    settings = list(dict.fromkeys(table["setting"]))
    figure = Figure(figsize=(5 * len(scenes) + 2.4, 4.6), layout="constrained")
    grid = figure.subplots(1, len(scenes), squeeze=False)[0]
    for axes, scene in zip(grid, scenes, strict=True):
        own = table[table["scene"] == scene].assign(error=lambda t: t["gradient_error"].clip(lower=NOTHING))
        front = own[own["non_dominated"]].sort_values("both_ms")
        axes.plot(front["both_ms"], front["error"], color="tab:red", linewidth=1, zorder=1)
        for i, setting in enumerate(settings):
            point = own[own["setting"] == setting]
            axes.scatter(point["both_ms"], point["error"], s=26, marker=MARKERS[i % len(MARKERS)],
                         color=f"C{i % 10}", label=setting, zorder=2)  # fmt: skip
        for row in front.itertuples():
            axes.annotate(row.setting, (row.both_ms, row.error), fontsize=7, xytext=(4, 4), textcoords="offset points")
        _logarithmic(axes, "forward + backward, ms", f"error of the gradients (0 drawn at {NOTHING:g})")
        axes.set_title(scene, fontsize=9)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", fontsize=7)
    save_figure(figure, target)


def draw_curves(curves: pd.DataFrame, target: Path) -> None:
    """Quality of the test views against seconds of training, one column per scene."""
    shown = [m for m in training.METRICS if curves[m].notna().any()]
    scenes = list(dict.fromkeys(curves["scene"]))
    figure = Figure(figsize=(5.2 * len(scenes), 2.6 * len(shown)), layout="constrained")
    grid = figure.subplots(len(shown), len(scenes), squeeze=False)
    for column, scene in enumerate(scenes):
        for row, metric in enumerate(shown):
            axes: Axes = grid[row][column]
            for i, (label, own) in enumerate(curves[curves["scene"] == scene].groupby("label", sort=False)):
                axes.plot(own["seconds"], own[metric].astype(float), marker=MARKERS[i % len(MARKERS)], markersize=3,
                          linewidth=1, label=str(label))  # fmt: skip
            axes.set_xscale("log")
            axes.set_ylabel(metric)
            axes.grid(linewidth=0.3)
            if row == 0:
                axes.set_title(scene, fontsize=9)
                axes.legend(fontsize=6)
        grid[-1][column].set_xlabel("seconds of training")
    save_figure(figure, target)


def draw_growth(table: pd.DataFrame, fitted: pd.DataFrame, target: Path) -> None:
    """Time and memory against size, one panel per axis."""
    figure = Figure(figsize=(3.4 * len(growth.AXES), 3), layout="constrained")
    slopes = fitted.set_index("axis")
    for axes, axis in zip(figure.subplots(1, len(growth.AXES)), growth.AXES, strict=True):
        own = table[table["axis"] == axis]
        axes.plot(own["size"], own["ms"], "o-", label=f"ms, exponent {slopes.loc[axis, 'time']:.2f}")
        axes.plot(own["size"], own["memory_mb"], "s--", label=f"MB, exponent {slopes.loc[axis, 'memory']:.2f}")
        _logarithmic(axes, axis, "")
        axes.legend(fontsize=7)
    save_figure(figure, target)


def _logarithmic(axes: Axes, x: str, y: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(linewidth=0.3)


def _write(table: pd.DataFrame, target: Path) -> None:
    write_text(target, table.to_csv(index=False, lineterminator="\n", na_rep="n/a"))


def _show(table: pd.DataFrame, console: Console, title: str) -> None:
    view = Table(*map(str, table.columns), title=title)
    for row in table.itertuples(index=False):
        view.add_row(*(_text(value) for value in row))
    console.print(view)


def _text(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else ""
    if not isinstance(value, float):
        return str(value)
    if np.isnan(value):
        return "n/a"
    size = abs(value)
    return f"{value:.1e}" if 0 < size < 1e-2 else f"{value:,.0f}" if size >= 1000 else f"{value:.3g}"
