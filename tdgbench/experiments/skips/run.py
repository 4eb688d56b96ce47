"""`+experiment=skips`: the cells, then the table of what each skip saved and cost, as CSV and as a picture."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tdgbench.bench.cell import Outcome
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.experiments.skips.table import skip_rows, summary
from tdgbench.experiments.skips.variants import run_variants
from tdgbench.files import write_text
from tdgbench.report.figures import save_figure


def run(cfg: DictConfig) -> None:
    """Run the cells that are missing; write and show the tables. Raises SystemExit(1) if a cell failed."""
    console = Console()

    def report(outcome: Outcome) -> None:
        if outcome.status not in ("ok", "kept", "elsewhere"):
            console.print(f"[red]{outcome.status}:[/red] {escape(outcome.title)}: {escape(outcome.message)}")

    outcomes = run_variants(cfg, CellProgress(Console(stderr=True), int(cfg.budget.iterations)), report)
    folder = Path(cfg.results) / cfg.name
    rows = skip_rows(read_all(folder))
    if not rows.empty:
        names = list(cfg.job.skips)
        table = summary(rows, names)
        write_text(folder / "skips_cells.csv", rows.to_csv(index=False, lineterminator="\n"))
        write_text(folder / "skips.csv", table.to_csv(index=False, lineterminator="\n"))
        draw(table, folder / "skips.png")
        show(table, console)
        console.print(f"table: {folder / 'skips.csv'}, cells: {folder / 'skips_cells.csv'}", soft_wrap=True)
    if any(outcome.status not in ("ok", "kept", "elsewhere") for outcome in outcomes):
        raise SystemExit(1)


def show(table: pd.DataFrame, console: Console) -> None:
    """Print the summary."""
    view = Table("skip", "found on", "faster alone", "slower without", "PSNR worst, dB", "SSIM worst", "may be")
    for row in table.itertuples():
        view.add_row(
            str(row.skip), str(row.taken_on), f"{row.faster_alone:.2f} ×",
            "" if pd.isna(row.slower_without) else f"{row.slower_without:.2f} ×",
            _change(row.psnr_worst, row.psnr_error, 3), _change(row.ssim_worst, row.ssim_error, 4),
            "on" if row.keep else "off",
        )  # fmt: skip
    console.print(view)


def _change(mean: float, error: float, digits: int) -> str:
    return f"{mean:+.{digits}f}" + ("" if pd.isna(error) else f" ± {error:.{digits}f}")


def draw(table: pd.DataFrame, target: Path) -> None:
    """Bars: how much faster each skip makes training alone, and how much slower it is without it."""
    figure = Figure(figsize=(8, 0.5 * len(table) + 1.2), layout="constrained")
    axes = figure.subplots()
    places = range(len(table))
    axes.barh([p - 0.2 for p in places], table["faster_alone"], height=0.38, label="none → this one: times faster")
    axes.barh([p + 0.2 for p in places], table["slower_without"], height=0.38, label="all → without it: times slower")
    labels = [f"{r.skip} (PSNR {r.psnr_worst:+.2f} dB at worst)" for r in table.itertuples()]
    axes.set_yticks(list(places), labels)
    axes.invert_yaxis()
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xlabel("ratio of training times (geometric mean over scenes)")
    axes.legend(fontsize=8)
    save_figure(figure, target)
