"""Run every stress case on every available backend."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import pandas as pd
from omegaconf import DictConfig

from tdgbench.experiments.stress import appearance, determinism, geometry, gradients, losses, training
from tdgbench.experiments.stress.case import Case, Verdict, judge
from tdgbench.experiments.stress.small import SmallTraining
from tdgbench.splats.backends import fast_backends


def backends() -> list[str]:
    """Fast backends that can run on this machine; all are compared with the reference."""
    return fast_backends()


def all_cases(cfg: DictConfig, folder: Path) -> list[Case]:
    """The whole suite. cfg: configuration of a small cell. folder: for what must be on disk."""
    small = SmallTraining(cfg, folder)
    return [
        *geometry.cases(), *appearance.cases(), *losses.cases(), *gradients.cases(), *training.cases(small),
        *determinism.cases(small),
    ]  # fmt: skip


def run_suite(cfg: DictConfig, chosen: str | None, report: Callable[[Verdict], None]) -> pd.DataFrame:
    """One row per case and backend; with `chosen`, only cases whose family or name contains it.

    report: called with each verdict. Raises ValueError if no case is chosen.
    """
    with tempfile.TemporaryDirectory() as folder:
        verdicts = []
        for case, backend in _pairs(all_cases(cfg, Path(folder)), chosen):
            verdict = judge(case, backend)
            report(verdict)
            verdicts.append(asdict(verdict))
    if not verdicts:
        raise ValueError(f"no stress case has {chosen!r} in its family or name")
    return pd.DataFrame(verdicts)


def _pairs(cases: list[Case], chosen: str | None) -> Iterator[tuple[Case, str]]:
    for case in cases:
        if chosen is None or chosen in case.family or chosen in case.name:
            for backend in backends() if case.every_backend else ["once"]:
                yield case, backend
