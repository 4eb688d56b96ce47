"""`+experiment=stress`: run the suite; a line per case and a CSV table; exit status 1 on a surprise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from omegaconf import DictConfig

from tdgbench.bench.options import OptionError
from tdgbench.bench.signature import Problem
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.stress import clouds, fields, losses, training
from tdgbench.experiments.stress.case import Case, run_case
from tdgbench.files import write_text
from tdgbench.splats.backends import fast_backends
from tdgbench.splats.cpu import pool
from tdgbench.terminal import say


@dataclass(frozen=True)
class StressOptions:
    """Options in `cfg.study`. cases: run only cases whose family or name contains this. fields: methods by name."""

    cases: str | None
    fields: dict[str, Any]


class Stress(Experiment):
    """The numerical stress suite."""

    options = StressOptions
    one_job = True

    def run(self, cfg: DictConfig) -> None:
        self.check(cfg)
        pool.set_threads(cfg.threads)
        torch.set_num_threads(1)
        chosen, rows = cfg.study.cases or "", []
        cases = [case for case in all_cases(cfg) if chosen in case.family or chosen in case.name]
        if not cases:
            raise OptionError([Problem("study.cases", "no case has this in its family or name", chosen)])
        for case in cases:
            for backend in backends_of(case, cfg.backend.name):
                row = run_case(case, backend)
                rows.append(row)
                line = f"{case.family}: {case.name} [{backend}]: {row['seen']}"
                if row["passed"]:
                    say(line, "as expected:", "green")
                else:
                    say(f"{line}; expected {case.expected}", "SURPRISE:")
        table = pd.DataFrame(rows)
        folder = Path(cfg.results) / cfg.name
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "stress.csv", table.to_csv(index=False, lineterminator="\n"))
        surprises = int((~table["passed"]).sum())
        say(f"{len(cases)} cases on {', '.join(table['backend'].unique())}: {surprises} surprises")
        say(f"table: {folder / 'stress.csv'}")
        if surprises:
            raise SystemExit(1)


def all_cases(cfg: DictConfig) -> list[Case]:
    """Return the whole suite. cfg: configuration of a small cell."""
    of_fields = [*fields.cases(), *fields.trainings(cfg, cfg.study.fields)]
    return [*clouds.cases(), *losses.cases(), *training.cases(cfg), *of_fields]


def backends_of(case: Case, chosen: str = "auto") -> list[str]:
    """Return what is compared with the reference: the chosen backend, with `auto` all fast ones of this machine.

    `once` where no backend matters.
    """
    if not case.every_backend:
        return ["once"]
    return fast_backends() if chosen == "auto" else [chosen]
