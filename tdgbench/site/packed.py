"""What the pages need of a pack: its tables, finished cells, manifest and checklist; the rows of its leaderboard."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tdgbench.cells.paths import folder_name
from tdgbench.cells.plan import Plan, read_plan
from tdgbench.cells.protocol import MEASURED_ON, protocol_settings
from tdgbench.cells.record import Record
from tdgbench.packs import manifest, unpacked
from tdgbench.packs.checklist import Item, checklist
from tdgbench.packs.manifest import Manifest
from tdgbench.present.grid import GridCell
from tdgbench.tables.build import Tables, build_tables
from tdgbench.tables.grids import SCENE_KEYS
from tdgbench.tables.long_table import method_label
from tdgbench.tables.measures import AVERAGE, OVERALL
from tdgbench.tables.palette import image_values
from tdgbench.tables.results import Cell

AVERAGES = (AVERAGE, OVERALL)


@dataclass(frozen=True)
class Pack:
    """An opened pack. name: of its file. sha256: of its manifest. tables: main ones, whatever its experiment."""

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
    def page(self) -> str:
        return f"packs/{self.sha256[: manifest.SHOWN]}.html"

    @property
    def commands(self) -> list[str]:
        """The command lines that check the pack, to be pasted into a shell."""
        file = f"./{self.name}" if self.name.startswith("-") else self.name
        words = [("verify", file), ("compare", file, "results/ours"),
                 ("unpack", file, f"results/{self.manifest.experiment}")]  # fmt: skip
        return [shlex.join(["tdgbench", *one]) for one in words]

    def mean_of(self, dataset: str) -> str:
        """Return the scenes that averages of a data set are over."""
        return ", ".join(sorted({cell.record.scene for cell in self.cells if cell.record.dataset == dataset}))


@dataclass(frozen=True)
class BoardRow:
    """A row of a leaderboard: a method's column on one scene, or on average over those of a pack.

    settings: of its protocol. scores: of each of COLUMNS.
    """

    pack: Pack
    protocol: str
    settings: dict[str, Any]
    dataset: str
    scene: str
    method: str
    column: str  # the method with its points and overrides
    records: list[Record]
    scores: tuple[GridCell, ...]
    truths: frozenset[int] = frozenset()  # numbers of `truth_groups`, of its cells

    @property
    def is_average(self) -> bool:
        return self.scene in AVERAGES

    @property
    def image_values(self) -> str:
        """Whether its images are in a palette, in words."""
        return image_values(self.records)

    @property
    def seeds(self) -> int:
        return len({record.seed for record in self.records})

    @property
    def measured_on(self) -> set[str]:
        """What the scores of its cells were measured on, as text."""
        fields = [[r.data.split("-")[0], *(getattr(r, name) for name in MEASURED_ON)] for r in self.records]
        return {json.dumps([*values, sorted(self.truths)], sort_keys=True) for values in fields}


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


def rows_of(pack: Pack, truths: Mapping[Path, int]) -> list[BoardRow]:
    """Return the rows of a pack: scenes that a method's column has a finished cell of, and averages over several.

    truths: `truth_groups` of the cells of all packs.
    """
    protocols = pack.tables.main.set_index(SCENE_KEYS)["protocol"].to_dict()
    scenes = {cell.dataset_and_scene for cell in pack.cells}
    in_dataset = Counter(dataset for dataset, _ in scenes)
    rows = []
    for row in pack.tables.grid.rows:
        dataset, scene, column = row.place
        is_shown = in_dataset[dataset] > 1 if scene == AVERAGE else (dataset, scene) in scenes
        if is_shown and any(cell.text != "n/a" for cell in row.cells):
            cells = [cell for cell in pack.cells if _is_behind(cell, dataset, scene, column)]
            first, found = cells[0].record, frozenset(truths[cell.folder] for cell in cells)
            settings, records = protocol_settings(first.config), [cell.record for cell in cells]
            rows.append(
                BoardRow(pack, protocols[row.place], settings, dataset, scene, first.method, column, records, row.cells,
                         found)
            )  # fmt: skip
    return rows


def _is_behind(cell: Cell, dataset: str, scene: str, column: str) -> bool:
    """Return whether a cell is one of those that a row of a leaderboard is of."""
    record = cell.record
    is_there = record.dataset == dataset and scene in (record.scene, AVERAGE)
    return is_there and method_label(record, with_init=True) == column
