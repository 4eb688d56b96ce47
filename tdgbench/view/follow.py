"""Follow the trainings of an experiment: the newest checkpoint of a cell that runs, then its result."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tdgbench.cells.folder import CellFolder, read_cells
from tdgbench.cells.paths import RECORD_FILE, cell_folder_of
from tdgbench.cells.record import read_record
from tdgbench.cells.renders import MethodInTraining
from tdgbench.scenes.modalities import THERMAL
from tdgbench.terminal import say
from tdgbench.text import one_line
from tdgbench.view.cells import ViewedCell, open_cell

EVERY = 2.0  # seconds between two looks
NO_CHECKPOINT = "no checkpoint yet (checkpoint=SECONDS of training between two, 120 by default; null: none)"


class Follower:
    """The cell of an experiment that runs, or ran last."""

    def __init__(self, experiment: Path) -> None:
        if not experiment.is_dir():
            raise ValueError(f"{experiment} is no folder; name that of an experiment, results/<name>")
        self._experiment, self._said = experiment, ""
        self._cell: ViewedCell | None = None
        self._seen: tuple[object, ...] = ()  # what the cell was read from

    def next(self, pause: Callable[[float], object]) -> dict[str, ViewedCell]:
        """Return the next state of the cell, or the next cell, under the experiment's name. Says what it waits for."""
        while True:
            before = self._cell
            try:
                words = self._look()
            except (ValueError, FileNotFoundError) as error:  # the latter: the run has just gone on
                words = str(error)
            if words != self._said:
                say(one_line(words))
                self._said = words
            if self._cell is not None and self._cell is not before:
                return {self._experiment.resolve().name: self._cell}
            pause(EVERY)

    def _look(self) -> str:
        """Read the cell if it has changed; return its state in words."""
        running = {folder: read_record(folder) for folder in (self._experiment / "running").glob("[!.]*")}
        paths = {folder: self._experiment / "checkpoints" / f"{folder.name}.pt" for folder in running}
        written = {folder: path.stat().st_mtime_ns for folder, path in paths.items() if path.exists()}
        last = None if self._cell is None else self._cell.cell.folder
        folder = last if last in written else max(written, key=written.__getitem__, default=None)
        if folder is None:
            waiting = [f"{record.title} runs, {NO_CHECKPOINT}" for record in running.values() if record is not None]
            return self._result("; ".join(waiting))
        record = running[folder]
        if (folder, written[folder]) != self._seen and record is not None:
            cell = CellFolder(folder, record)
            cameras = cell.cameras
            method = MethodInTraining(paths[folder], record, cameras)
            if THERMAL not in method.models:
                raise ValueError(f"{record.title}: iteration {method.iterations:,}, no thermal Gaussians yet")
            count, at = sum(map(len, method.models.values())), time.localtime(written[folder] / 1e9)
            state = f"iteration {method.iterations:,}, {count:,} Gaussians at {time.strftime('%H:%M:%S', at)}"
            self._cell = ViewedCell(cell, method.models, cameras["train"], cameras["test"], method, state)
            self._seen = folder, written[folder]
        return self._words()

    def _result(self, waiting: str) -> str:
        """Read the result of the cell, or without a cell the newest one; `waiting` says what runs."""
        cell = self._cell
        if cell is None:
            found = [cell.folder for cell in read_cells(self._experiment) if cell.record.failure is None]
            folder = max(found, key=lambda one: (one / RECORD_FILE).stat().st_mtime, default=None)
            if folder is None:
                return waiting or f"no cell of {self._experiment} runs or is finished"
        else:
            folder = cell_folder_of(self._experiment, cell.record)
        record = read_record(folder)
        if record is None or (cell is not None and record.key != cell.record.key):
            state = "it has no result, and does not run"
        elif record.failure is not None:
            state = record.why_failed
        else:
            state = f"finished after {record.iterations:,} iterations, {sum(record.gaussians.values()):,} Gaussians"
            cell = cell if self._seen == (folder,) else open_cell(folder)
        state, self._seen = "; ".join(filter(None, [state, waiting])), (folder,)
        if cell is not None and cell.state != state:
            self._cell = replace(cell, state=state)
        return self._words()

    def _words(self) -> str:
        return "" if self._cell is None else f"{self._cell.record.title}: {self._cell.state}"
