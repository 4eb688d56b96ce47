"""A finished cell: its record, its folder, and what comparisons ask about it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pandas as pd

from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.record import Record
from tdgbench.tables.results import method_label


@dataclass(frozen=True)
class Cell:
    """A cell that has scores, and its folder with log.csv, views.csv and pictures."""

    record: Record
    folder: Path

    @property
    def label(self) -> str:
        """Its method's column, with the seed unless that is 0."""
        return method_label(self.record, with_init=True) + (f", seed {self.record.seed}" if self.record.seed else "")

    @property
    def budget(self) -> int:
        """The planned number of iterations; on a plateau training ends before."""
        return int(self.record.config.get("budget", {}).get("iterations", self.record.iterations))

    @property
    def scene(self) -> tuple[str, str]:
        """Data set and scene."""
        return self.record.dataset, self.record.scene

    @property
    def machine(self) -> tuple[str, ...]:
        """The hardware that times depend on."""
        return tuple(str(self.record.environment.get(name)) for name in ("cpu", "gpu", "threads"))

    @property
    def setup(self) -> str:
        """All settings but method, prior, init, seed and number of iterations."""
        config = {k: v for k, v in self.record.config.items() if k not in ("method", "prior", "init", "seed", "budget")}
        budget = {k: v for k, v in self.record.config.get("budget", {}).items() if k not in ("iterations", "name")}
        place = [*self.scene, self.record.data, self.record.split]
        return json.dumps([*place, config, budget], sort_keys=True)

    def log(self) -> pd.DataFrame | None:
        """log.csv: iteration, seconds, train_psnr (dB, smoothed), loss_thermal, …; None if there is none."""
        return _read_csv(self.folder / "log.csv")

    def views(self) -> pd.DataFrame | None:
        """views.csv: view and its scores, NaN for n/a; None if there is none."""
        return _read_csv(self.folder / "views.csv")


def finished_cells(experiment: Path, records: Iterable[Record]) -> list[Cell]:
    """The cells of an experiment that have scores."""
    return [Cell(record, cell_folder_of(experiment, record)) for record in records if record.failure is None]


@cache
def _read_csv(path: Path) -> pd.DataFrame | None:
    return pd.read_csv(path) if path.exists() else None
