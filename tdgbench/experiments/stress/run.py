"""`+experiment=stress`: run the suite; table on the terminal, as CSV and as a picture; exit status 1 on a surprise."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from omegaconf import DictConfig
from rich.markup import escape

from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.stress import clouds, gradients, losses, training
from tdgbench.experiments.stress.case import Case, CaseResult, run_case
from tdgbench.experiments.stress.small import SmallTraining
from tdgbench.files import write_text
from tdgbench.report.figures import save_figure
from tdgbench.splats.backends import fast_backends
from tdgbench.splats.cpu import pool
from tdgbench.terminal import console, say

FLOOR = 1e-5  # smaller shares are drawn here


@dataclass(frozen=True)
class StressOptions:
    """Options in `cfg.job`. cases: run only cases whose family or name contains this."""

    cases: str | None


class Stress(Experiment):
    """The numerical stress suite."""

    options = StressOptions

    def run(self, cfg: DictConfig) -> None:
        """Run the cases that `cfg.job.cases` chooses. Raises SystemExit(1) if any case is a surprise."""
        self.check(cfg)
        out = console()
        pool.set_threads(cfg.threads)
        torch.set_num_threads(1)

        def report(result: CaseResult) -> None:
            mark = "[green]as expected[/green]" if result.passed else "[red]SURPRISE[/red]"
            title = f"{result.family}: {result.case} [{result.backend}]"
            out.print(f"{escape(title):<72}{mark}  {escape(result.seen)}", highlight=False, soft_wrap=True)
            if not result.passed:
                say(f"    expected {result.expected}")

        table = run_suite(cfg, cfg.job.cases, report)
        folder = Path(cfg.results) / cfg.name
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "stress.csv", table.to_csv(index=False, lineterminator="\n"))
        draw_errors(table, folder / "stress.png")
        surprises = int((~table["passed"]).sum())
        cases = len(table[["family", "case"]].drop_duplicates())
        backends = ", ".join(dict.fromkeys(table["backend"]))
        say(f"{cases} cases on {backends}: {surprises} surprises")
        say(f"table: {folder / 'stress.csv'}, picture: {folder / 'stress.png'}")
        if surprises:
            raise SystemExit(1)


def all_cases(cfg: DictConfig, folder: Path) -> list[Case]:
    """Return the whole suite. cfg: configuration of a small cell. folder: for what must be on disk."""
    return [*clouds.cases(), *losses.cases(), *gradients.cases(), *training.cases(SmallTraining(cfg, folder))]


def backends_of(case: Case) -> list[str]:
    """Return the fast backends of this machine, which are compared with the reference; `once` where none matters."""
    return fast_backends() if case.every_backend else ["once"]


def run_suite(cfg: DictConfig, chosen: str | None, report: Callable[[CaseResult], None]) -> pd.DataFrame:
    """Return one row per case and backend; with `chosen`, only cases whose family or name contains it.

    report: called with each result. Raises ValueError if no case is chosen.
    """
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for case in all_cases(cfg, Path(folder)):
            if chosen is None or chosen in case.family or chosen in case.name:
                for backend in backends_of(case):
                    results.append(run_case(case, backend))
                    report(results[-1])
    if not results:
        raise ValueError(f"no stress case has {chosen!r} in its family or name")
    return pd.DataFrame(map(asdict, results))


def draw_errors(table: pd.DataFrame, target: Path) -> None:
    """Draw the error of each case that measures one, relative to its limit; NaN is at the right edge."""
    measured = table[table["share"].notna() | (~table["passed"])].reset_index(drop=True)
    figure = Figure(figsize=(9, 0.19 * max(len(measured), 4) + 1), layout="constrained")
    axes = figure.subplots()
    shares = measured["share"].astype(float).fillna(np.inf).clip(FLOOR, 1e3)
    for family in dict.fromkeys(measured["family"]):
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
    if len(measured):
        axes.legend(fontsize=7, loc="lower right")
    save_figure(figure, target)
