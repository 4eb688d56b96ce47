"""`+experiment=stress`: the suite's table on the terminal, as CSV and as a picture; exit status 1 on a surprise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from tdgbench.experiments.stress.case import Verdict
from tdgbench.experiments.stress.suite import run_suite
from tdgbench.files import write_text
from tdgbench.report.figures import save_figure
from tdgbench.splats.cpu import pool

FLOOR = 1e-5  # shares below are drawn here


def run(cfg: DictConfig) -> None:
    """Run the suite that a configuration asks for. Raises SystemExit(1) if any case shows a surprise."""
    console = Console()
    pool.set_threads(cfg.threads)
    torch.set_num_threads(1)

    def report(verdict: Verdict) -> None:
        mark = "[green]as expected[/green]" if verdict.passed else "[red]SURPRISE[/red]"
        title = f"{verdict.family}: {verdict.case} [{verdict.backend}]"
        console.print(f"{escape(title):<72}{mark}  {escape(verdict.seen)}", highlight=False, soft_wrap=True)
        if not verdict.passed:
            console.print(f"    expected {escape(verdict.expected)}", highlight=False, soft_wrap=True)

    table = run_suite(cfg, cfg.job.cases, report)
    folder = Path(cfg.results) / cfg.name
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "stress.csv", table.to_csv(index=False, lineterminator="\n"))
    draw(table, folder / "stress.png")
    surprises = int((~table["passed"]).sum())
    cases = len(table[["family", "case"]].drop_duplicates())
    where = ", ".join(dict.fromkeys(table["backend"]))
    console.print(f"{cases} cases on {where}: {surprises} surprises", highlight=False)
    console.print(f"table: {folder / 'stress.csv'}, picture: {folder / 'stress.png'}", highlight=False, soft_wrap=True)
    if surprises:
        raise SystemExit(1)


def draw(table: pd.DataFrame, target: Path) -> None:
    """The errors of all cases that measure one, as shares of what is allowed; NaN stands at the right edge."""
    measured = table[table["share"].notna() | (~table["passed"])].reset_index(drop=True)
    height = 0.19 * max(len(measured), 4) + 1
    figure = Figure(figsize=(9, height), layout="constrained")
    axes = figure.subplots()
    shares = measured["share"].astype(float).fillna(np.inf).clip(FLOOR, 1e3)
    families = list(dict.fromkeys(measured["family"]))
    for family in families:
        own = measured["family"] == family
        axes.scatter(shares[own], measured.index[own], s=14, label=family)
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
