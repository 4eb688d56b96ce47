"""The cells of the viewer, read and checked: finished ones, and the one of an experiment that trains."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tdgbench.cells.folder import CellFolder, read_cells
from tdgbench.cells.known_classes import UnknownMethodError
from tdgbench.cells.paths import CHECKPOINTS, RECORD_FILE, RUNNING, cell_folder_of, files_of
from tdgbench.cells.record import Record, read_record, record_files
from tdgbench.cells.renders import MethodInTraining, StoredMethod, response_of
from tdgbench.scenes import Camera
from tdgbench.scenes.modalities import LABELS, THERMAL
from tdgbench.splats import Gaussians
from tdgbench.terminal import say
from tdgbench.text import one_line
from tdgbench.thermal import ImageResponse

EVERY = 2.0  # seconds between two looks
PATIENCE = 300  # seconds that the checkpoint of the cell shown may be older than another one's
NO_CHECKPOINT = "no checkpoint yet (checkpoint=SECONDS of training between two, 120 by default; null: none)"


@dataclass(frozen=True)
class ViewedCell:
    """A cell as the viewer shows it: a finished one, whose files are those of its record, or one that is followed."""

    cell: CellFolder
    models: dict[str, Gaussians]  # by modality: `thermal`, and others that the method trains
    train: dict[str, Camera]  # by view
    test: dict[str, Camera]
    method: StoredMethod | None = None  # that renders more than the Gaussians of the models; None: these are all
    state: str = ""  # of a cell that is followed, or that is not shown whole, in words

    @property
    def record(self) -> Record:
        return self.cell.record

    @property
    def cameras(self) -> dict[str, Camera]:
        """Cameras of all views, training views first."""
        return {**self.train, **self.test}

    @property
    def modalities(self) -> list[str]:
        """The modalities that can be rendered."""
        return list(self.models) if self.method is None else list(self.method.modalities)

    @property
    def degC(self) -> tuple[float, float] | None:
        """Temperatures of the values 0 and 1; None if the thermal images are pseudo-colour or no range is known."""
        low_high = self.record.temperature_range
        return (low_high[0], low_high[1]) if low_high is not None and self.record.channels == 1 else None

    @cached_property
    def response(self) -> ImageResponse:
        """Response of the thermal camera to renders, read once and not for each frame."""
        return response_of(self.record)

    def pictures(self, view: str) -> dict[str, np.ndarray]:
        """Return the pictures of a test view, (H, W, 1 or 3) uint8, by modality: ground truth, else stored renders.

        Cells store none of training views. Raises ValueError, naming the file, if one cannot be read.
        """
        pictures: dict[str, np.ndarray] = {}
        for modality in LABELS if view in self.test else ():
            files, size = files_of(modality), (self.test[view].width, self.test[view].height)
            kind = next((kind for kind in (files.targets, files.renders) if self.cell.has(kind, view)), None)
            if kind is not None:
                try:
                    pictures[modality] = self.cell.picture(kind, view, size)
                except (ValueError, OSError) as error:
                    raise ValueError(f"{self.cell.folder}: {error}") from error
        return pictures


def open_cells(folders: Sequence[Path]) -> dict[str, ViewedCell]:
    """Return the cells by short names. Raises ValueError, naming a folder, if they cannot be shown.

    They must be finished, unchanged since their record was written, and of one scene.
    """
    cells = [open_cell(folder) for folder in dict.fromkeys(folders)]
    first = cells[0]
    for cell in cells[1:]:
        if (cell.record.dataset, cell.record.scene) != (first.record.dataset, first.record.scene):
            raise ValueError(
                f"{cell.cell.folder} is of scene {cell.record.scene}, {first.cell.folder} of {first.record.scene}; "
                "cells side by side must be of one scene"
            )
    return dict(zip(short_names([cell.record for cell in cells]), cells, strict=True))


def open_cell(folder: Path) -> ViewedCell:
    """Read a cell. Raises ValueError, naming the folder, if it is none, has failed, or was changed."""
    cell = CellFolder(folder, _record_of(folder))
    if cell.record.status != "ok":
        raise ValueError(f"{folder} has no model: it {cell.record.why_failed}")
    for problem in cell.file_problems():
        raise ValueError(f"{folder} is damaged: {problem}; run the cell again, or see tdgbench verify")
    try:
        cameras, models = cell.cameras, cell.models()
        method, state = _method_of(cell)
    except (ValueError, OSError) as error:
        raise ValueError(f"{folder} cannot be shown: {error}") from error
    if THERMAL not in models and method is not None and not cell.has_model:
        raise ValueError(
            f"{folder} cannot be shown: it lacks Gaussians: its renders are images, which the report shows"
        )
    renders = THERMAL in models or method is not None
    if not renders or not cameras["test"]:
        lacking = "a test view" if renders else files_of(THERMAL).model
        raise ValueError(f"{folder} cannot be shown: it lacks {lacking}")
    return ViewedCell(cell, models, cameras["train"], cameras["test"], method, state)


def _record_of(folder: Path) -> Record:
    """Return the record in a folder. Raises ValueError, with an example of a cell's folder if there is one."""
    record = None if folder.is_file() else read_record(folder)
    if record is not None:
        return record
    state, cells = "is not there", list[Path]()
    if folder.is_dir():
        state, cells = "holds no record", record_files(folder)
    elif folder.exists():
        state = "is no folder (tdgbench unpack makes one of a pack)"
    example = f", such as {cells[0].parent}" if cells else f", which has a {RECORD_FILE}"
    raise ValueError(f"{folder} {state}; name the folder of a cell{example}")


def _method_of(cell: CellFolder) -> tuple[StoredMethod | None, str]:
    """Return the method of a cell with parts beside its Gaussians, else None; and why it is not shown, in words."""
    if not cell.has_parts:
        return None, ""
    try:
        return cell.method(), ""
    except UnknownMethodError as error:
        return None, f"its Gaussians alone, not what its method renders: {error}"


def _counted(gaussians: int) -> str:
    return f", {gaussians:,} Gaussians" if gaussians else ""


def short_names(records: Sequence[Record]) -> list[str]:
    """Return names of cells of one scene: the method, and what else is needed to tell them apart.

    >>> tdg, msmg = (Record(method, "paper", "Truck", "colmap", 0, "table1", "") for method in ("tdg", "msmg"))
    >>> short_names([tdg, msmg]), short_names([tdg, tdg])
    (['tdg', 'msmg'], ['tdg', 'tdg (2)'])
    """
    parts = [[r.method, r.init, f"seed {r.seed}", r.variant, r.experiment] for r in records]
    differs = [len({part[i] for part in parts}) > 1 for i in range(len(parts[0]))]
    differs[0] = True
    names: list[str] = []
    for part in parts:
        name = ", ".join(text for text, shown in zip(part, differs, strict=True) if shown and text)
        taken = sum(other == name or other.startswith(f"{name} (") for other in names)
        names.append(f"{name} ({taken + 1})" if taken else name)
    return names


def followed(written: Mapping[Path, int], last: Path | None) -> Path | None:
    """Return the running cell to show: the last one, but for a checkpoint that is much older, as of a killed training.

    written: when the checkpoints were written, ns.

    >>> a, b = Path("a"), Path("b")
    >>> followed({a: 0, b: 10**9}, a).name, followed({a: 0, b: 400 * 10**9}, a).name
    ('a', 'b')
    """
    if last is not None and last in written and max(written.values()) - written[last] <= PATIENCE * 10**9:
        return last
    return max(written, key=written.__getitem__, default=None)


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
        running = {folder: read_record(folder) for folder in (self._experiment / RUNNING).glob("[!.]*")}
        paths = {folder: self._experiment / CHECKPOINTS / f"{folder.name}.pt" for folder in running}
        written = {folder: path.stat().st_mtime_ns for folder, path in paths.items() if path.exists()}
        last = None if self._cell is None else self._cell.cell.folder
        folder = followed(written, last)
        if folder is None:
            waiting = [f"{record.title} runs, {NO_CHECKPOINT}" for record in running.values() if record is not None]
            return self._result("; ".join(waiting))
        record = running[folder]
        if (folder, written[folder]) != self._seen and record is not None:
            cell = CellFolder(folder, record)
            cameras = cell.cameras
            method = MethodInTraining(paths[folder], record, cameras)
            if method.stage_modality != THERMAL:
                raise ValueError(f"{record.title}: iteration {method.iterations:,}, not trained on thermal images yet")
            count, at = sum(map(len, method.models.values())), time.localtime(written[folder] / 1e9)
            state = f"iteration {method.iterations:,}{_counted(count)} at {time.strftime('%Y-%m-%d %H:%M:%S', at)}"
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
            state = f"finished after {record.iterations:,} iterations{_counted(sum(record.gaussians.values()))}"
            cell = cell if self._seen == (folder,) else open_cell(folder)
        state, self._seen = "; ".join(filter(None, [state, waiting])), (folder,)
        if cell is not None and cell.state != state:
            self._cell = replace(cell, state=state)
        return self._words()

    def _words(self) -> str:
        return "" if self._cell is None else f"{self._cell.record.title}: {self._cell.state}"
