"""Experiments over named axes: each combination of one choice per axis is a cell, which runs as a sweep's cells do."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import pandas as pd
from omegaconf import DictConfig, OmegaConf
from pydantic import Field, NonNegativeInt

from tdgbench.bench.options import OptionError
from tdgbench.bench.progress import SUCCESS, CellProgress, Outcome, finished_records
from tdgbench.bench.run_cell import run_cell
from tdgbench.bench.signature import Problem
from tdgbench.cells.record import Record
from tdgbench.experiments.experiment import Experiment
from tdgbench.files import write_text
from tdgbench.tables.as_csv import as_csv
from tdgbench.tables.palette import IMAGES, image_values
from tdgbench.terminal import console, say


@dataclass(frozen=True)
class MatrixOptions:
    """Options in `cfg.study` of every matrix: its axes `scene` and `seed`."""

    scenes: Annotated[list[str | None], Field(min_length=1)]  # None: the only one
    seeds: Annotated[list[NonNegativeInt], Field(min_length=1)]


class AxisValue(NamedTuple):
    """A value on an axis. options: what it sets, by dotted names. variant: its part of the cell's variant."""

    label: Any
    options: Mapping[str, Any]
    variant: str = ""


Axes = Mapping[str, Sequence[AxisValue]]
QUALITY = ("psnr", "ssim", "lpips")  # scores that experiments compare


class MatrixCell(NamedTuple):
    """A cell of a matrix. labels: its choices by axis. record: its result; None without one."""

    labels: dict[str, Any]
    cfg: DictConfig
    outcome: Outcome
    record: Record | None


class Matrix(Experiment):
    """Cells over named axes, and tables of their numbers.

    A subclass states its axes and tables. missing: what the tables say for a missing number.
    """

    one_job = True
    sets: ClassVar[Mapping[str, str]] = {"scene": "study.scenes=[NAME,...]", "seed": "study.seeds=[0,...]"}
    missing: ClassVar[str] = "n/a"

    @abstractmethod
    def axes(self, cfg: DictConfig) -> Axes:
        """Return the axes by name, `scene` among them; cells run in the order of their product."""

    def is_cell(self, labels: Mapping[str, Any]) -> bool:
        """Return whether a combination of choices, by axis, is a cell; by default each one is."""
        return True

    @abstractmethod
    def tables(self, cfg: DictConfig, cells: Sequence[MatrixCell]) -> dict[str, pd.DataFrame]:
        """Return the tables by the names of their files; none where there is nothing to tell."""

    @staticmethod
    def image_values(cells: Iterable[MatrixCell]) -> str:
        """Return the column `image_values` of a number over the finished ones of these cells."""
        return image_values(cell.record for cell in cells if cell.record is not None)

    @abstractmethod
    def show(self, table: pd.DataFrame) -> None:
        """Print the first of the tables."""

    def run(self, cfg: DictConfig) -> None:
        """Run the cells that have no result; write and print the tables. Raises SystemExit(1) if a cell failed."""
        self.check(cfg)
        cells = self.run_cells(cfg)
        tables = self.tables(cfg, cells)
        if tables:
            write_tables(Path(cfg.results) / cfg.name, tables, self.missing)
            self.show(next(iter(tables.values())))
            say(f"tables: {', '.join(str(Path(cfg.results) / cfg.name / f'{name}.csv') for name in tables)}")
        if any(cell.outcome.status not in SUCCESS for cell in cells):
            raise SystemExit(1)

    def run_cells(self, cfg: DictConfig) -> list[MatrixCell]:
        """Run the cells that have no result, the last axis first; print one line for each, and why one failed.

        Raises OptionError before the first one if two would be stored in one place.
        """
        ran = []
        for labels, cell, variant in self._planned(cfg):
            progress = CellProgress(console(stderr=True), cell.budget.iterations)
            outcome = run_cell(cell, variant, progress)
            say(outcome.line, stderr=True)
            if outcome.status not in SUCCESS:
                say(f"{outcome.title}: {outcome.message}", f"{outcome.status}:")
            ran.append((labels, cell, outcome))
        finished = finished_records(Path(cfg.results) / cfg.name, [outcome for *_, outcome in ran])
        records = {record.title: record for record in finished}
        away = [outcome for *_, outcome in ran if outcome.status == "elsewhere" and outcome.title not in records]
        if away:
            say(f"{len(away)} cells run in other processes and are in no table: repeat the command", "missing:")
        return [MatrixCell(labels, cell, outcome, records.get(outcome.title)) for labels, cell, outcome in ran]

    def _planned(self, cfg: DictConfig) -> list[tuple[dict[str, Any], DictConfig, str]]:
        """Return the labels, the configuration and the variant of each cell."""
        axes = self.axes(cfg)
        found: dict[tuple[Any, ...], tuple[dict[str, Any], DictConfig, str]] = {}
        for choices in product(*axes.values()):
            labels = dict(zip(axes, (choice.label for choice in choices), strict=True))
            if not self.is_cell(labels):
                continue
            cell, variant = configured(cfg, choices), ",".join(choice.variant for choice in choices if choice.variant)
            place = cell.method.name, cell.scene, cell.init.name, cell.seed, variant
            if place in found:
                of_both = " and ".join(", ".join(map(str, one.values())) for one in (found[place][0], labels))
                what = f"{of_both} would be one cell: give one of them a `name` of its own"
                raise OptionError([Problem("study", what)])
            found[place] = labels, cell, variant
        return list(found.values())


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame], missing: str = "n/a") -> None:
    """Write tables as CSV files of these names. missing: what stands for a missing number."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        write_text(folder / f"{name}.csv", as_csv(table, na_rep=missing))


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


def table_of(cells: Iterable[MatrixCell], numbers: Callable[[Record], Mapping[str, Any]]) -> pd.DataFrame:
    """Return one row per finished cell: a column per axis, the numbers, `image_values`."""
    return pd.DataFrame(
        [
            {**cell.labels, "scene": one.scene, **numbers(one), IMAGES: image_values([one])}
            for cell in cells
            if (one := cell.record) is not None
        ]
    )
