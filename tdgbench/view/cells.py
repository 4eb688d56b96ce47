"""The cells of the viewer: records, models, cameras and stored pictures, read and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.known_classes import UnknownMethodError
from tdgbench.cells.paths import RECORD_FILE, files_of
from tdgbench.cells.record import Record, read_record, record_files
from tdgbench.cells.renders import StoredMethod, response_of
from tdgbench.scenes import Camera
from tdgbench.scenes.modalities import LABELS, THERMAL
from tdgbench.splats import Gaussians
from tdgbench.thermal import ImageResponse


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
    if THERMAL not in models and method is not None:
        raise ValueError(
            f"{folder} cannot be shown: it lacks Gaussians: its renders are images, which the report shows"
        )
    if THERMAL not in models or not cameras["test"]:
        lacking = "a test view" if THERMAL in models else files_of(THERMAL).model
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
