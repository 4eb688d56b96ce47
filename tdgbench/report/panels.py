"""Small plots of a scene as SVG that follows the page's colours: training curves, and errors in °C."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tdgbench.present.figures import as_svg, plain
from tdgbench.scenes.modalities import LABELS, OTHERS
from tdgbench.tables import methods
from tdgbench.tables.cell_names import cell_title
from tdgbench.tables.long_table import method_label
from tdgbench.tables.results import Cell

CURVES = {"loss": "loss", "smoothed_psnr": "PSNR of training renders, dB", "gaussians": "Gaussians"}
SUMMED = ("loss", "gaussians")
MOST_POINTS = 150  # of a curve; a plot of 3 inches shows no more
BINS = 31  # at most, of errors
SHARES = (0.5, 0.95)  # of pixels, within which errors are stated


def line_colours(columns: Iterable[str]) -> dict[str, str]:
    """Return the colour of each method's lines, by column."""
    return {column: f"C{i % 10}" for i, column in enumerate(dict.fromkeys(columns))}


def curve_panels(cells: Sequence[Cell], colours: Mapping[str, str], problems: list[str]) -> list[str]:
    """Return loss, PSNR and number of Gaussians along each cell's training, as SVG; unreadable logs are n/a.

    colours: by column; the seeds of a method share one. Losses and Gaussians are sums over a method's models, which the
    legend names where there are several.
    """
    logs: list[tuple[str, pd.DataFrame]] = []
    models: dict[str, str] = {}
    for cell in cells:
        if cell.record.made_elsewhere is not None:
            continue
        log = cell.log
        if log is None or not {"seconds", *CURVES} <= set(log.columns):
            problems.append(f"{cell_title(cell.record)}: log.csv is missing or no log, so its curves are n/a")
            continue
        column = method_label(cell.record, with_init=True)
        summed = sorted(cell.record.gaussians, key=OTHERS.__contains__)
        models[column] = f", {' + '.join(LABELS.get(name, name) for name in summed)}" if len(summed) > 1 else ""
        logs.append((column, log.iloc[:: -(-len(log) // MOST_POINTS)]))
    panels = []
    for column, title in CURVES.items() if logs else ():
        figure, axes = _panel(title, "seconds of training")
        for i, (method, log) in enumerate(logs):
            is_first = all(before != method for before, _ in logs[:i])
            label = methods.label(method) + models[method] * (column in SUMMED)
            axes.plot(log["seconds"], log[column], color=colours[method], linewidth=1,
                      label=plain(label) if is_first else None)  # fmt: skip
        panels.append(_as_svg(figure, axes))
    return panels


def settling_panel(cells: Sequence[Cell], colours: Mapping[str, str]) -> dict[str, Any]:
    """Return the PSNR of held-out views along each training as SVG, with a dot where it settled, and why in sentences.

    Both are empty where no training held views out, as without `SettlingRule`; with `has_gaps`, curves are cut where
    the images' size changes. Other modalities have dashed lines.
    """
    figure, axes = _panel("PSNR of held-out training views, dB", "iterations")
    drawn, why, has_gaps = list[str](), list[str](), False
    for cell in cells:
        column = method_label(cell.record, with_init=True)
        for name, part in cell.record.parts.items():
            checks = [row for row in part.get("checks") or () if len(row) == 3]
            if not checks:
                continue
            other = next((f", {LABELS[one]}" for one in OTHERS if name.endswith(f"{one}_curriculum")), "")
            label, settled_at = methods.label(column) + other, part.get("settled_at", 0)
            iterations, scales, psnrs = zip(*checks, strict=True)
            starts = [i for i in range(1, len(scales)) if scales[i] != scales[i - 1]]  # gaps: two sizes do not compare
            has_gaps |= bool(starts)
            along, shown = (np.insert(np.array(each, float), starts, np.nan) for each in (iterations, psnrs))
            axes.plot(along, shown, ".--" if other else ".-", color=colours[column], linewidth=1, markersize=1.5,
                      label=None if label in drawn else plain(label))  # fmt: skip
            drawn.append(label)
            before = [psnr for iteration, psnr in zip(iterations, psnrs, strict=True) if iteration <= settled_at]
            if before:
                axes.plot(settled_at, before[-1], "o", color=colours[column], markersize=3)
                reason = part.get("reason", "n/a")
                why.append(f"{cell_title(cell.record)}{other}: settled at iteration {settled_at}, since {reason}")
    return {"svg": _as_svg(figure, axes) if drawn else "", "why": why, "has_gaps": has_gaps}


def error_panel(
    errors: Mapping[str, np.ndarray], span: Sequence[float], colours: Sequence[str]
) -> dict[str, Any] | None:
    """Return a histogram of errors (render − truth) in °C as SVG, and rows of text on them; None without errors.

    errors: `error_counts` by label. span: °C of values 0 and 1.
    """
    if not errors:
        return None
    step = (span[1] - span[0]) / 255
    levels = np.arange(-255, 256)
    widest = max(_within(counts, levels, 0.995) for counts in errors.values())
    per_bin = -(-(2 * widest + 1) // BINS) // 2 * 2 + 1  # odd, so that all bins hold equally many levels
    figure, axes = _panel("99.5 % of the errors, share of the pixels (log)", "render − ground truth, °C")
    rows = []
    for (label, counts), colour in zip(errors.items(), colours, strict=True):
        bins = np.round(levels / per_bin).astype(int)
        shares = np.bincount(bins - bins[0], weights=counts) / counts.sum()
        shown = np.abs(np.unique(bins)) * per_bin <= widest + per_bin
        axes.step(np.unique(bins)[shown] * per_bin * step, shares[shown], where="mid", color=colour, linewidth=1,
                  label=plain(label))  # fmt: skip
        mean = float((counts * levels).sum() / counts.sum() * step)
        digits = max(0, int(np.ceil(-np.log10(max(step, 1e-9)))))
        ends = [_within(counts, levels, share) * step for share in SHARES]
        within = (f"{end:.{digits}f}" if end else f"< {10.0**-digits:g}" for end in ends)
        largest = np.abs(levels[counts > 0]).max() * step
        rows.append([label, *within, f"{largest:.{digits}f}", f"{round(mean, digits + 1) + 0.0:+.{digits + 1}f}"])
    axes.set_yscale("log")
    heads = ["method", *(f"{100 * share:.0f} % within ±, °C" for share in SHARES), "largest, °C", "mean, °C"]
    return {"svg": _as_svg(figure, axes), "heads": heads, "rows": rows, "step": f"{step:.1g} °C"}


def _within(counts: np.ndarray, levels: np.ndarray, share: float) -> int:
    """Return the least number of levels within which so large a share of the errors is."""
    by_size = np.bincount(np.abs(levels), weights=counts)
    return int(np.searchsorted(by_size.cumsum(), share * by_size.sum()))


def _panel(title: str, below: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(3.6, 2.5))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.17, right=0.97, bottom=0.19, top=0.89)
    axes.set_title(title, fontsize=9, y=1.0)
    axes.set_xlabel(below, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(linewidth=0.3)
    return figure, axes


def _as_svg(figure: Figure, axes: Axes) -> str:
    axes.legend(fontsize=7, framealpha=0, labelcolor="black")
    return as_svg(figure)
