"""A finished cell as comparisons see it."""

from __future__ import annotations

import json
from functools import cached_property

import pandas as pd

from tdgbench.cells.folder import CellFolder
from tdgbench.scoring import METRICS
from tdgbench.tables.long_table import method_label, planned_iterations


class Cell(CellFolder):
    """A finished cell with the properties that comparisons need, and its tables as far as they are usable."""

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

    @cached_property
    def log(self) -> pd.DataFrame | None:
        """The training log: iteration, seconds, smoothed_psnr (dB), loss_thermal, …; None if there is no usable one."""
        try:
            rows = self.read_log()
        except (OSError, ValueError):
            return None
        return pd.DataFrame(rows) if rows else None

    @cached_property
    def views(self) -> pd.DataFrame | None:
        """Scores by the view's name, NaN for n/a; None if there are no usable ones."""
        try:
            rows = self.read_views()
        except (OSError, ValueError):
            return None
        return pd.DataFrame(list(rows.values()), list(rows), list(METRICS), dtype=float)
