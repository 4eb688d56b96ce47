"""Cells over named axes: each combination of one choice per axis is a cell, which runs as a sweep's cells do.

An experiment with a matrix states its axes, the numbers of its table, and its figures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import pandas as pd
from omegaconf import DictConfig, OmegaConf
from pydantic import Field, NonNegativeInt

from tdgbench.bench.outcome import SUCCESS, Outcome, finished_records
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.run_cell import run_cell
from tdgbench.cells.record import Record
from tdgbench.terminal import console, say


@dataclass(frozen=True)
class MatrixOptions:
    """Options in `cfg.study` of every matrix: its axes `scene` and `seed`, which the experiment `sets`."""

    SETS: ClassVar = {"scene": "study.scenes=[NAME,...]", "seed": "study.seeds=[0,...]"}
    scenes: Annotated[list[str | None], Field(min_length=1)]  # None: the only one
    seeds: Annotated[list[NonNegativeInt], Field(min_length=1)]


class AxisValue(NamedTuple):
    """A value on an axis. options: what it sets, by dotted names. variant: its part of the cell's variant."""

    label: Any
    options: Mapping[str, Any]
    variant: str = ""


Axes = Mapping[str, Sequence[AxisValue]]


class MatrixCell(NamedTuple):
    """A cell of a matrix. labels: its choices by axis. record: its result; None without one."""

    labels: dict[str, Any]
    cfg: DictConfig
    outcome: Outcome
    record: Record | None


def values_of(option: str, values: Iterable[Any]) -> list[AxisValue]:
    """Return an axis of the values of an option that is part of a cell's path.

    >>> values_of("seed", [0, 1])
    [AxisValue(label=0, options={'seed': 0}, variant=''), AxisValue(label=1, options={'seed': 1}, variant='')]
    """
    return [AxisValue(value, {option: value}) for value in values]


def groups_of(option: str, choices: Mapping[Any, Any], variant: str = "") -> list[AxisValue]:
    """Return an axis of configurations of an option, by name. variant: name of the axis in the cells' variants.

    >>> groups_of("thermal_camera", {"ideal": {"estimate": False}}, variant="thermal_camera")
    [AxisValue(label='ideal', options={'thermal_camera': {'estimate': False}}, variant='thermal_camera=ideal')]
    """
    return [
        AxisValue(str(name), {option: config}, f"{variant}={name}" if variant else "")
        for name, config in choices.items()
    ]


def configured(cfg: DictConfig, choices: Iterable[AxisValue]) -> DictConfig:
    """Return a copy of a configuration with the options of these choices."""
    cell = cfg.copy()
    for choice in choices:
        for option, value in choice.options.items():
            OmegaConf.update(cell, option, value, merge=False, force_add=True)
    return cell


def run_cells(cfg: DictConfig, axes: Axes) -> list[MatrixCell]:
    """Run the cells that have no result, the last axis first; print one line for each, and why one failed."""
    ran = []
    for choices in product(*axes.values()):
        cell = configured(cfg, choices)
        progress = CellProgress(console(stderr=True), cell.budget.iterations)
        outcome = run_cell(cell, ",".join(choice.variant for choice in choices if choice.variant), progress)
        say(outcome.line, stderr=True)
        if outcome.status not in SUCCESS:
            say(f"{outcome.title}: {outcome.message}", f"{outcome.status}:")
        ran.append((dict(zip(axes, (choice.label for choice in choices), strict=True)), cell, outcome))
    finished = finished_records(Path(cfg.results) / cfg.name, [outcome for *_, outcome in ran])
    records = {record.title: record for record in finished}
    return [MatrixCell(labels, cell, outcome, records.get(outcome.title)) for labels, cell, outcome in ran]


def check_all_ran(cells: Iterable[MatrixCell]) -> None:
    """Raise SystemExit(1) if a cell failed."""
    if any(cell.outcome.status not in SUCCESS for cell in cells):
        raise SystemExit(1)


def table_of(cells: Iterable[MatrixCell], numbers: Callable[[Record], Mapping[str, Any]]) -> pd.DataFrame:
    """Return one row per finished cell: a column per axis, then the numbers. A scene has the name in its record."""
    return pd.DataFrame(
        [
            {**cell.labels, "scene": cell.record.scene, **numbers(cell.record)}
            for cell in cells
            if cell.record is not None
        ]
    )
