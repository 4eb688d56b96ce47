"""What a claim is held against: tables, and the trained cells behind ours."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pandas as pd

from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.plan import Plan
from tdgbench.bench.record import Record, read_all
from tdgbench.scenes.registry import DATASETS
from tdgbench.tables.results import AVERAGE, OVERALL, scene_rows, with_averages, with_bold

HOLDS, FAILS, UNDECIDED = "holds", "fails", "undecided"
METHODS = ("tdg", "msmg")


class MissingError(Exception):
    """The evidence has no number that a claim is about."""


@dataclass(frozen=True)
class Finding:
    """What became of a claim, and why."""

    verdict: str
    seen: str


@dataclass(frozen=True)
class Cell:
    """A cell that has scores, and its folder, which holds log.csv and views.csv."""

    record: Record
    folder: Path

    @property
    def budget(self) -> int:
        """The iterations asked for; a plateau may have ended training before."""
        return int(self.record.config.get("budget", {}).get("iterations", self.record.iterations))

    @property
    def scene(self) -> tuple[str, str]:
        return self.record.dataset, self.record.scene

    @property
    def machine(self) -> tuple[str, ...]:
        """What times depend on."""
        return tuple(str(self.record.environment.get(name)) for name in ("cpu", "gpu", "threads"))

    @property
    def setup(self) -> str:
        """Everything that was set but method, prior, init, seed and number of iterations."""
        config = {k: v for k, v in self.record.config.items() if k not in ("method", "prior", "init", "seed", "budget")}
        budget = {k: v for k, v in self.record.config.get("budget", {}).items() if k not in ("iterations", "name")}
        place = [*self.scene, self.record.data, self.record.split]
        return json.dumps([*place, config, budget], sort_keys=True)

    def log(self) -> pd.DataFrame | None:
        """log.csv: iteration, seconds, train_psnr (dB, smoothed), loss_thermal, …; None if there is none."""
        return _read_csv(self.folder / "log.csv")

    def views(self) -> pd.DataFrame | None:
        """views.csv: view and its scores, NaN where it has none; None if there is none."""
        return _read_csv(self.folder / "views.csv")


@cache
def _read_csv(path: Path) -> pd.DataFrame | None:
    return pd.read_csv(path) if path.exists() else None


@dataclass(frozen=True)
class Evidence:
    """A main table (method, dataset, group, scene, metric, value, bold) and an ablation (method, init, metric, value).

    printed: whether the values were rounded for print, so that each is known to half a unit only. cells: those behind
    the tables, where they are ours. note: which cells the main table is made of, in words.
    """

    main: pd.DataFrame
    ablation: pd.DataFrame | None
    printed: bool
    cells: tuple[Cell, ...] = ()
    note: str = ""

    @property
    def overall(self) -> str:
        """The scene that stands for all: with one data set its average, which is the average over all scenes."""
        if (self.main["scene"] == OVERALL).any() or len(set(self.main["dataset"]) - {""}) != 1:
            return OVERALL
        return AVERAGE

    @property
    def is_of_paper(self) -> bool:
        """Whether the main table has the paper's scenes and no others."""
        return set(self.main["dataset"]) - {""} <= set(DATASETS.values())


def evidence_of(experiments: Iterable[Path]) -> Evidence:
    """Our evidence: every cell of the experiments that has scores.

    Cells of a sweep over a method's or a prior's settings are left out: they are not the method as its YAML has it.
    Raises ValueError for a folder without records.
    """
    cells = []
    for folder in experiments:
        records = read_all(folder)
        if not records:
            raise ValueError(f"{folder} holds no records; run an experiment first")
        cells += [Cell(r, cell_folder_of(folder, r)) for r in records if r.failure is None and _is_plain(r)]
    chosen = as_published(cells)
    rows = scene_rows(
        [replace(cell.record, variant="") for cell in chosen], Plan(methods=list(METHODS) if chosen else [])
    )
    return Evidence(with_bold(with_averages(rows)), None, False, tuple(cells), _lengths(chosen))


def as_published(cells: Sequence[Cell]) -> list[Cell]:
    """The cells that make the main table: TDg and MSMG from COLMAP points, with equal setup and seed, at the lengths of
    `published_lengths`."""
    lengths = published_lengths(cells)
    chosen: dict[str, dict[tuple[str, int], Cell]] = {method: {} for method in METHODS}
    for cell in cells:
        method = cell.record.method
        if cell.record.init == "colmap" and lengths.get((method, cell.setup)) == cell.budget:
            chosen[method].setdefault((cell.setup, cell.record.seed), cell)
    shared = chosen["tdg"].keys() & chosen["msmg"].keys()
    return [cell for by_place in chosen.values() for place, cell in by_place.items() if place in shared]


def published_lengths(cells: Sequence[Cell]) -> dict[tuple[str, str], int]:
    """By method and setup: TDg's fewest and MSMG's most iterations, as the paper has them (10 000 and 30 000)."""
    found: dict[tuple[str, str], int] = {}
    for method, pick in (("tdg", min), ("msmg", max)):
        for cell in cells:
            if cell.record.method == method and cell.record.init == "colmap":
                place = (method, cell.setup)
                found[place] = pick(found.get(place, cell.budget), cell.budget)
    return found


def _is_plain(record: Record) -> bool:
    return not any(override.startswith(("method.", "prior")) for override in record.variant.split(","))


def _lengths(cells: Sequence[Cell]) -> str:
    """`4 scenes; TDg at 1000, MSMG at 3000 iterations`; empty without cells."""
    if not cells:
        return ""
    parts = []
    for method, name in (("tdg", "TDg"), ("msmg", "MSMG")):
        budgets = sorted({cell.budget for cell in cells if cell.record.method == method})
        parts.append(f"{name} at {' and '.join(str(budget) for budget in budgets)}")
    scenes = len({cell.scene for cell in cells})
    return f"{scenes} scene{'s' if scenes > 1 else ''}; {', '.join(parts)} iterations"
