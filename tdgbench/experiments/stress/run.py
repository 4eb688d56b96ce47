"""`+experiment=stress`: run the suite; table on the terminal, as CSV and as a picture; exit status 1 on a surprise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.markup import escape

from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.stress.case import Verdict
from tdgbench.experiments.stress.draw import draw
from tdgbench.experiments.stress.suite import run_suite
from tdgbench.files import write_text
from tdgbench.splats.cpu import pool
from tdgbench.terminal import console, say


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

        def report(verdict: Verdict) -> None:
            mark = "[green]as expected[/green]" if verdict.passed else "[red]SURPRISE[/red]"
            title = f"{verdict.family}: {verdict.case} [{verdict.backend}]"
            out.print(f"{escape(title):<72}{mark}  {escape(verdict.seen)}", highlight=False, soft_wrap=True)
            if not verdict.passed:
                say(f"    expected {verdict.expected}")

        table = run_suite(cfg, cfg.job.cases, report)
        folder = Path(cfg.results) / cfg.name
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "stress.csv", table.to_csv(index=False, lineterminator="\n"))
        draw(table, folder / "stress.png")
        surprises = int((~table["passed"]).sum())
        cases = len(table[["family", "case"]].drop_duplicates())
        backends = ", ".join(dict.fromkeys(table["backend"]))
        say(f"{cases} cases on {backends}: {surprises} surprises")
        say(f"table: {folder / 'stress.csv'}, picture: {folder / 'stress.png'}")
        if surprises:
            raise SystemExit(1)
