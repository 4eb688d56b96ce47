"""What the pages need of a pack: its tables, finished cells, manifest and checklist; the rows of its leaderboard."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from statistics import fmean
from typing import Any

import pandas as pd

from tdgbench.cells.folder import shared_content
from tdgbench.cells.paths import folder_name
from tdgbench.cells.plan import Plan, read_plan
from tdgbench.cells.protocol import protocol_settings
from tdgbench.cells.record import Record
from tdgbench.packs import manifest, unpacked
from tdgbench.packs.checklist import Item, checklist
from tdgbench.packs.manifest import Manifest
from tdgbench.present.grid import GridCell
from tdgbench.tables import methods
from tdgbench.tables.build import Tables, build_tables
from tdgbench.tables.columns import own_columns
from tdgbench.tables.grids import ERROR, SCENE_KEYS, main_grid
from tdgbench.tables.long_table import iterations_in_words, method_label, metric_value, prior_in_words
from tdgbench.tables.measures import AVERAGE, COLUMNS, OVERALL, is_of_training, measure_of, own_metrics
from tdgbench.tables.overrides import training_in_words
from tdgbench.tables.palette import image_values
from tdgbench.tables.results import Cell

AVERAGES = (AVERAGE, OVERALL)
SCORES = tuple(one for name in COLUMNS for one in ((name, ERROR) if name == "psnr" else (name,)))  # of rows and cells
HEADS = [measure_of(name).title for name in SCORES]


@dataclass(frozen=True)
class Pack:
    """An opened pack. name: of its file. sha256: of its manifest. tables: main ones, whatever its experiment.

    Its methods and metrics are printed as its plan says, beside packs that may say otherwise of the same names.
    """

    name: str
    size: int
    sha256: str
    manifest: Manifest
    plan: Plan
    checklist: list[Item]
    tables: Tables

    @property
    def cells(self) -> list[Cell]:
        """The finished cells."""
        return self.tables.results.finished

    @property
    def methods(self) -> str:
        """The methods of its cells, as it prints them."""
        return joined(self.label(record.method) for record in self.tables.records)

    @property
    def own_metrics(self) -> list[str]:
        """The metrics that are none of tdgbench's, of which it has a number, but for scores of training views."""
        known = set(self.tables.main.loc[self.tables.main["value"].notna(), "metric"])
        with own_columns(self.plan):
            return [name for name in own_metrics() if name in known and not is_of_training(name)]

    def label(self, column: str, training: str = "") -> str:
        """Return a column's method as the pack prints it, without options of the budget that `training` has."""
        name, _, variant = column.partition(" [")
        options = [one for one in variant.removesuffix("]").split(",")
                   if one and not (one.startswith("budget.") and one.removeprefix("budget.") in training)]  # fmt: skip
        with own_columns(self.plan):
            return methods.label(name + (f" [{','.join(options)}]" if options else ""))

    @cached_property
    def psnr_intervals(self) -> pd.DataFrame:
        """The ends of the 95 % intervals of PSNR, dB, by dataset, scene and method."""
        main = self.tables.main
        rows = main[main["metric"] == "psnr"].set_index(SCENE_KEYS)
        return rows[["ci95_low", "ci95_high"]].astype(float)

    @property
    def page(self) -> str:
        return f"packs/{self.sha256[: manifest.SHOWN]}.html"

    @property
    def commands(self) -> list[str]:
        """The command lines that check the pack, to be pasted into a shell."""
        file = f"./{self.name}" if self.name.startswith("-") else self.name
        words = [("verify", file), ("compare", file, "results/ours"),
                 ("unpack", file, f"results/{self.manifest.experiment}")]  # fmt: skip
        return [shlex.join(["tdgbench", *one]) for one in words]


@dataclass(frozen=True)
class BoardRow:
    """A row of a leaderboard: a method's column on one scene, or on average over those of a pack.

    settings: of its protocol. scores: of each of SCORES. own: of the pack's own metrics, by title and meaning. setups:
    what its cells have to share with those of a rival, as JSON. ranks: best and worst one among `rivals` rows of all
    packs, see `ranked`; None for the reason in `unranked`, which may be that it and its rivals are unlike, or
    that a record was changed (`is_unlike`). tied: those that it cannot be told from. twin: which other pack holds its
    cells too, in words.
    """

    pack: Pack
    protocol: str
    settings: dict[str, Any]
    dataset: str
    scene: str
    method: str
    column: str  # the method with its points and overrides
    cells: list[Cell]
    scores: tuple[GridCell, ...]
    own: dict[tuple[str, str], GridCell]
    setups: frozenset[str] = frozenset()
    ranks: tuple[int, int] | None = None
    rivals: int = 0
    tied: tuple[str, ...] = ()
    unranked: str = "no other row to compare with"
    is_unlike: bool = False
    twin: str = ""

    @property
    def label(self) -> str:
        return self.pack.label(self.column, self.training)

    @property
    def started(self) -> tuple[str, str]:
        """The method and its initial points, without options."""
        return self.method, self.records[0].init

    @property
    def is_average(self) -> bool:
        return self.scene in AVERAGES

    @property
    def records(self) -> list[Record]:
        return [cell.record for cell in self.cells]

    @property
    def image_values(self) -> str:
        """Whether its images are in a palette, in words."""
        return image_values(self.records)

    @property
    def rank(self) -> str:
        return "–" if self.ranks is None else "–".join(dict.fromkeys(map(str, self.ranks)))

    @cached_property
    def content(self) -> frozenset[str]:
        """What its cells share with equal ones; empty if that is not known of all."""
        found = [shared_content(one) for one in self.records]
        return frozenset(found) if all(found) else frozenset()

    @property
    def scenes(self) -> list[str]:
        return sorted({record.scene for record in self.records})

    @property
    def training(self) -> str:
        """Its budget, in words."""
        return joined(training_in_words(record) for record in self.records)

    @cached_property
    def facts(self) -> dict[str, str]:
        """What readers ask of a row beside its scores, by the column's heading."""
        ranges = {"n/a" if r.temperature_range is None else "{:.4g} to {:.4g}".format(*r.temperature_range)
                  for r in self.records}  # fmt: skip
        seeds = Counter(record.scene for record in self.records)
        return {
            "seeds": joined(map(str, sorted(set(seeds.values())))),
            "test views": joined(str(record.views.get("test", "n/a")) for record in self.records)
            + " each" * (len(self.scenes) > 1),
            "iterations": iterations_in_words(self.records),
            "size, px": joined(size_of(cell) for cell in self.cells),
            "range, °C": "several" if len(ranges) > 1 else ranges.pop(),
        }

    @property
    def prior(self) -> str:
        """What its depth prior is made from if not from the thermal images alone, else its name."""
        return joined(map(prior_in_words, self.records))

    @property
    def psnr_interval(self) -> tuple[float, float]:
        """The ends of the 95 % interval over seeds and views that stands below its PSNR, dB; NaN without one."""
        low, high = self.pack.psnr_intervals.loc[(self.dataset, self.scene, self.column)]
        return low, high

    @property
    def machines(self) -> set[tuple[str, ...]]:
        """The hardware that its times are of."""
        return {cell.machine for cell in self.cells}

    def by_seed(self, metric: str) -> dict[int, float]:
        """Return a number of each seed that all scenes have, on average over them."""
        values: dict[int, dict[str, float]] = {}
        for record in self.records:
            values.setdefault(record.seed, {})[record.scene] = metric_value(record, metric)[0]
        return {seed: fmean(found.values()) for seed, found in values.items() if len(found) == len(self.scenes)}


def joined(texts: Iterable[str]) -> str:
    """Return the texts, each once."""
    return ", ".join(dict.fromkeys(texts))


def size_of(cell: Cell) -> str:
    """Return the size of a cell's test views, px."""
    try:
        return joined(f"{camera.width}×{camera.height}" for camera in cell.test_cameras.values())
    except (OSError, ValueError):
        return "n/a"


def scene_page(dataset: str, scene: str) -> str:
    """Return the place of a scene's page.

    >>> scene_page("synthetic", "orbit")
    'scenes/synthetic/orbit.html'
    """
    return f"scenes/{folder_name(dataset)}/{folder_name(scene)}.html"


def method_page(method: str) -> str:
    """Return the place of a method's page.

    >>> method_page("tdg")
    'methods/tdg.html'
    """
    return f"methods/{folder_name(method)}.html"


@contextmanager
def opened_packs(paths: Sequence[Path]) -> Iterator[list[Pack]]:
    """Yield packs by name, each once, unpacked into a temporary folder. Raises ValueError for what is no pack."""
    with ExitStack() as stack:
        packs: dict[str, Pack] = {}
        for path in paths:
            if not path.is_file():
                raise ValueError(f"{path} is no file; make one of a results folder with tdgbench pack")
            folder, content, sha256 = stack.enter_context(unpacked(path))
            packs[sha256] = _read(path, folder, content, sha256)
        yield sorted(packs.values(), key=lambda pack: (pack.manifest.experiment, pack.sha256))


def _read(path: Path, folder: Path, content: Manifest, sha256: str) -> Pack:
    plan, items = read_plan(folder), checklist(folder)
    replace(plan, table="main").write(folder)  # an ablation has a leaderboard as well
    return Pack(path.name, path.stat().st_size, sha256, content, plan, items, build_tables(folder))


def rows_of(pack: Pack, setups: Mapping[Path, str]) -> list[BoardRow]:
    """Return the rows of a pack: scenes that a method's column has a finished cell of, and averages over all of them.

    setups: of the cells of all packs, by folder.
    """
    protocols, heads = pack.tables.main.set_index(SCENE_KEYS)["protocol"].to_dict(), pack.tables.grid.columns
    own = pack.own_metrics
    with own_columns(pack.plan):
        titles = [(measure_of(name).title, measure_of(name).meaning) for name in own]
        further = main_grid(pack.tables.main.assign(bold=False), None, own).rows if own else []
    of_place = {row.place: row.cells for row in further}
    in_dataset = Counter(dataset for dataset, _ in {cell.dataset_and_scene for cell in pack.cells})
    rows = []
    for row in pack.tables.grid.rows:
        dataset, scene, column = row.place
        by_head = dict(zip(heads, row.cells, strict=True))
        scores = tuple(by_head.get(head, GridCell())._replace(bold=False) for head in HEADS)
        cells = [cell for cell in pack.cells if _is_behind(cell, dataset, scene, column)]
        of_average = len({cell.record.scene for cell in cells}) == in_dataset[dataset] > 1
        if of_average if scene == AVERAGE else cells:
            first, found = cells[0].record, frozenset(setups[cell.folder] for cell in cells)
            rows.append(
                BoardRow(pack, protocols[row.place], protocol_settings(first.config), dataset, scene, first.method,
                         column, cells, scores, dict(zip(titles, of_place.get(row.place, ()), strict=True)), found)
            )  # fmt: skip
    return rows


def _is_behind(cell: Cell, dataset: str, scene: str, column: str) -> bool:
    """Return whether a cell is one of those that a row of a leaderboard is of."""
    record = cell.record
    is_there = record.dataset == dataset and scene in (record.scene, AVERAGE)
    return is_there and method_label(record, with_init=True) == column
