"""Run cells, and what tests of failing ones look at."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import DictConfig
from rich.console import Console

from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import Outcome, run_cell
from tdgbench.cells.record import read_all
from tdgbench.training.checkpoint import Checkpoint
from tests.helpers.configs import SMALL, config


def run_quietly(cfg: DictConfig, variant: str = "") -> Outcome:
    """Run a cell that prints nothing."""
    return run_cell(cfg, variant, CellProgress(Console(quiet=True), 1))


def small_cells(results: Path, data_root: Path, *cells: tuple[str, ...], status: str = "ok") -> Path:
    """Run small cells, one for each of these overrides; return the experiment's folder."""
    words = (*SMALL, "budget=demo", "budget.iterations=30", "prior=synthetic", f"data.root={data_root}")
    for overrides in cells:
        assert run_quietly(config(*words, f"results={results}", *overrides)).status == status
    return results / "single"


def statuses(experiment) -> list[str]:
    return [record.status for record in read_all(experiment)]


def hidden(folder) -> list[str]:
    return sorted(path.name for path in folder.parent.iterdir() if path.name.startswith("."))


def fails(error):
    """A function of an object and a value, as `GaussianSplatting.step`, that raises an error."""

    def step(self, value):
        raise error

    return step


class PulledPlugError(BaseException):
    """Not an Exception, so that nothing catches it, like SIGKILL."""


def killed_at(iteration: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let trainings write a checkpoint at every iteration, and die after that of the given one."""
    write_if_due = Checkpoint.write_if_due

    def write_and_die(self, log):
        self._next = 0.0
        write_if_due(self, log)
        if log.iterations == iteration:
            raise PulledPlugError

    monkeypatch.setattr(Checkpoint, "write_if_due", write_and_die)
