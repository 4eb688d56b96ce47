"""`+experiment=skips`: run the cells, then tabulate and draw what each skip saved and cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import pandas as pd
from omegaconf import DictConfig
from pydantic import Field, NonNegativeInt
from rich.console import Console
from rich.table import Table

from tdgbench.bench.outcome import SUCCESS, Outcome, finished_cells
from tdgbench.bench.progress import CellProgress
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.preparation import prepare_prior
from tdgbench.experiments.skips.draw import draw
from tdgbench.experiments.skips.table import skip_rows, summary
from tdgbench.experiments.skips.variants import run_variants
from tdgbench.files import write_text
from tdgbench.tables.as_csv import as_csv
from tdgbench.terminal import console, say


@dataclass(frozen=True)
class SkipAblationOptions:
    """Options in `cfg.job`: what to run; skips outside of `skips` are off in all cells."""

    scenes: Annotated[list[str | None], Field(min_length=1)]  # None: the only one
    skips: list[str]
    seeds: Annotated[list[NonNegativeInt], Field(min_length=1)]


class SkipAblation(Experiment):
    """Cells with each skip alone, with all but one, with all and with none."""

    options = SkipAblationOptions
    sets: ClassVar[Mapping[str, str]] = {"scene": "job.scenes=[NAME,...]", "seed": "job.seeds=[0,...]"}

    def start(self, cfg: DictConfig) -> None:
        """Raises PriorUnavailableError if the cells' prior is not available."""
        prepare_prior(cfg)

    def run(self, cfg: DictConfig) -> None:
        """Run the cells that have no result; write and print the tables. Raises SystemExit(1) if a cell failed."""
        self.check(cfg)

        def report(outcome: Outcome) -> None:
            say(outcome.line, stderr=True)
            if outcome.status not in SUCCESS:
                say(f"{outcome.title}: {outcome.message}", f"{outcome.status}:")

        outcomes = run_variants(cfg, CellProgress(console(stderr=True), cfg.budget.iterations), report)
        folder = Path(cfg.results) / cfg.name
        rows = skip_rows(finished_cells(folder, outcomes))
        if not rows.empty:
            table = summary(rows, list(cfg.job.skips))
            write_text(folder / "skips_cells.csv", as_csv(rows))
            write_text(folder / "skips.csv", as_csv(table))
            draw(table, folder / "skips.png")
            show(table, console())
            say(f"table: {folder / 'skips.csv'}, cells: {folder / 'skips_cells.csv'}")
        if any(outcome.status not in SUCCESS for outcome in outcomes):
            raise SystemExit(1)


def show(table: pd.DataFrame, out: Console) -> None:
    """Print the summary."""
    view = Table("skip", "taken on", "faster alone", "slower without", "worst PSNR, dB", "worst SSIM", "default may be")
    for row in table.itertuples():
        view.add_row(
            str(row.skip), str(row.taken_on), f"{row.faster_alone:.2f} ×",
            "" if pd.isna(row.slower_without) else f"{row.slower_without:.2f} ×",
            _change(row.psnr_worst, row.psnr_error, 3), _change(row.ssim_worst, row.ssim_error, 4),
            "on" if row.keep else "off",
        )  # fmt: skip
    out.print(view)


def _change(mean: float, error: float, digits: int) -> str:
    return f"{mean:+.{digits}f}" + ("" if pd.isna(error) else f" ± {error:.{digits}f}")
