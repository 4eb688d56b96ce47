"""Bar chart of what each skip saves."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from tdgbench.report.figures import save_figure


def draw(table: pd.DataFrame, target: Path) -> None:
    """Draw how much faster training is with each skip alone, and how much slower without it."""
    figure = Figure(figsize=(8, 0.5 * len(table) + 1.2), layout="constrained")
    axes = figure.subplots()
    rows = range(len(table))
    axes.barh([r - 0.2 for r in rows], table["faster_alone"], height=0.38, label="none → this one: times faster")
    axes.barh([r + 0.2 for r in rows], table["slower_without"], height=0.38, label="all → without it: times slower")
    labels = [f"{r.skip} (worst PSNR {r.psnr_worst:+.2f} dB)" for r in table.itertuples()]
    axes.set_yticks(list(rows), labels)
    axes.invert_yaxis()
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xlabel("ratio of training times (geometric mean over scenes)")
    axes.legend(fontsize=8)
    save_figure(figure, target)
