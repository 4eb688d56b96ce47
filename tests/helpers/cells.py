"""Run cells, and what tests of failing ones look at."""

from __future__ import annotations

from omegaconf import DictConfig
from rich.console import Console

from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import Outcome, run_cell
from tdgbench.cells.record import read_all


def run_quietly(cfg: DictConfig, variant: str = "") -> Outcome:
    """Run a cell that prints nothing."""
    return run_cell(cfg, variant, CellProgress(Console(quiet=True), 1))


def statuses(experiment) -> list[str]:
    return [record.status for record in read_all(experiment)]


def hidden(folder) -> list[str]:
    return sorted(path.name for path in folder.parent.iterdir() if path.name.startswith("."))


def fails(error):
    """A function of an object and a value, as `GaussianSplatting.step`, that raises an error."""

    def step(self, value):
        raise error

    return step
