"""A finished cell: its record, its folder, and the properties that comparisons need."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pandas as pd

from tdgbench.bench.scores import read_views
from tdgbench.cells.paths import cell_folder_of
from tdgbench.cells.read_files import table_text
from tdgbench.cells.record import Record
from tdgbench.scoring import METRICS
from tdgbench.tables.long_table import method_label, planned_iterations


@dataclass(frozen=True)
class Cell:
    """A cell that has scores, and its folder with log.csv, views.csv and pictures."""

    record: Record
    folder: Path

    @property
    def label(self) -> str:
        """The label of the method's column, with the seed unless that is 0."""
        return method_label(self.record, with_init=True) + (f", seed {self.record.seed}" if self.record.seed else "")

    @property
    def planned_iterations(self) -> int:
        """The planned number of iterations; on a plateau training ends before."""
        return planned_iterations(self.record)

    @property
    def dataset_and_scene(self) -> tuple[str, str]:
        return self.record.dataset, self.record.scene

    @property
    def machine(self) -> tuple[str, ...]:
        """The hardware that times depend on."""
        return tuple(str(self.record.environment.get(name)) for name in ("cpu", "gpu", "threads"))

    @property
    def settings_key(self) -> str:
        """All settings but method, prior, init, seed and number of iterations."""
        config = {k: v for k, v in self.record.config.items() if k not in ("method", "prior", "init", "seed", "budget")}
        whole = self.record.setting("budget")
        budget = {k: v for k, v in whole.items() if k not in ("iterations", "name")} if isinstance(whole, dict) else {}
        place = [*self.dataset_and_scene, self.record.data, self.record.split]
        return json.dumps([*place, config, budget], sort_keys=True)

    def log(self) -> pd.DataFrame | None:
        """Read log.csv: iteration, seconds, smoothed_psnr (dB), loss_thermal, …; None if it is not there, or no log."""
        return _log(self.folder / "log.csv")

    def views(self) -> pd.DataFrame | None:
        """Read views.csv: scores by the view's name, NaN for n/a; None if it is not there, or has another form."""
        return _views(self.folder / "views.csv")


def finished_cells(experiment: Path, records: Iterable[Record]) -> list[Cell]:
    """Return the cells of an experiment that have scores."""
    return [Cell(record, cell_folder_of(experiment, record)) for record in records if record.failure is None]


@cache
def _views(path: Path) -> pd.DataFrame | None:
    try:
        rows = read_views(path)
    except (OSError, ValueError):
        return None
    return pd.DataFrame(list(rows.values()), list(rows), list(METRICS), dtype=float)


@cache
def _log(path: Path) -> pd.DataFrame | None:
    try:
        log = pd.read_csv(io.StringIO(table_text(path))).apply(pd.to_numeric, errors="coerce")
    except (OSError, ValueError):  # pandas raises ValueError for what is no table
        return None
    return log if len(log) and {"iteration", "seconds", "smoothed_psnr"} <= set(log.columns) else None
