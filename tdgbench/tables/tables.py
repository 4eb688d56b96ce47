"""What the tables of an experiment hold, for those who print and show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from tdgbench.bench.record import Record
from tdgbench.tables.statistics import Comparison


@dataclass(frozen=True, kw_only=True)
class Tables:
    """The tables of an experiment. difference and papers are None where nothing is published for these scenes."""

    kind: str  # main, ablation or readings
    main: pd.DataFrame
    latex: str
    difference: pd.DataFrame | None
    folder: Path
    records: list[Record]  # the cells behind the tables
    findings: list[str]  # in sentences
    problems: list[str]  # what could not be read
    comparisons: Sequence[Comparison] = ()  # of methods with their baselines
    papers: pd.DataFrame | None = None  # spread between papers
    readings: pd.DataFrame | None = None  # by method and length; of table=readings alone
    effects: pd.DataFrame | None = None
