"""`+experiment=stress`: run the suite; a line per case and a CSV table; exit status 1 on a surprise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig
from rich.markup import escape

from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.stress import clouds, losses, training
from tdgbench.experiments.stress.case import Case, CaseResult, run_case
from tdgbench.files import write_text
from tdgbench.splats.backends import fast_backends
from tdgbench.splats.cpu import pool
from tdgbench.terminal import console, say


@dataclass(frozen=True)
class StressOptions:
    """Options in `cfg.study`. cases: run only cases whose family or name contains this."""

    cases: str | None


class Stress(Experiment):
    """The numerical stress suite."""

    options = StressOptions

    def run(self, cfg: DictConfig) -> None:
        """Run the cases that `cfg.study.cases` chooses. Raises SystemExit(1) if any case is a surprise."""
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

        table = run_suite(cfg, cfg.study.cases, report)
        folder = Path(cfg.results) / cfg.name
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "stress.csv", table.to_csv(index=False, lineterminator="\n"))
        surprises = int((~table["passed"]).sum())
        cases = len(table[["family", "case"]].drop_duplicates())
        backends = ", ".join(dict.fromkeys(table["backend"]))
        say(f"{cases} cases on {backends}: {surprises} surprises")
        say(f"table: {folder / 'stress.csv'}")
        if surprises:
            raise SystemExit(1)


def all_cases(cfg: DictConfig) -> list[Case]:
    """Return the whole suite. cfg: configuration of a small cell."""
    return [*clouds.cases(), *losses.cases(), *training.cases(training.SmallTraining(cfg))]


def backends_of(case: Case) -> list[str]:
    """Return the fast backends of this machine, which are compared with the reference; `once` where none matters."""
    return fast_backends() if case.every_backend else ["once"]


def run_suite(cfg: DictConfig, chosen: str | None, report: Callable[[CaseResult], None]) -> pd.DataFrame:
    """Return one row per case and backend; with `chosen`, only cases whose family or name contains it.

    report: called with each result. Raises ValueError if no case is chosen.
    """
    results = []
    for case in all_cases(cfg):
        if chosen is None or chosen in case.family or chosen in case.name:
            for backend in backends_of(case):
                results.append(run_case(case, backend))
                report(results[-1])
    if not results:
        raise ValueError(f"no stress case has {chosen!r} in its family or name")
    return pd.DataFrame(map(asdict, results))
