"""Picture of the stress suite: errors relative to their limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tdgbench.report.figures import save_figure

FLOOR = 1e-5  # smaller shares are drawn here


def draw(table: pd.DataFrame, target: Path) -> None:
    """Draw the error of each case that measures one, relative to its limit; NaN is at the right edge."""
    measured = table[table["share"].notna() | (~table["passed"])].reset_index(drop=True)
    height = 0.19 * max(len(measured), 4) + 1
    figure = Figure(figsize=(9, height), layout="constrained")
    axes = figure.subplots()
    shares = measured["share"].astype(float).fillna(np.inf).clip(FLOOR, 1e3)
    families = list(dict.fromkeys(measured["family"]))
    for family in families:
        rows = measured["family"] == family
        axes.scatter(shares[rows], measured.index[rows], s=14, label=family)
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xlim(FLOOR / 2, 2e3)
    labels = [f"{r.case} [{r.backend}]" for r in measured.itertuples()]
    axes.set_yticks(range(len(measured)), labels, fontsize=6)
    axes.invert_yaxis()
    axes.set_xlabel("error / allowed error, against the float64 reference (the larger of image and gradients)")
    axes.grid(axis="x", linewidth=0.3)
    if families:
        axes.legend(fontsize=7, loc="lower right")
    save_figure(figure, target)
