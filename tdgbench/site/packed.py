"""What the pages need of a pack: its tables, finished cells, manifest and checklist; the rows of its leaderboard."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tdgbench.cells.paths import folder_name
from tdgbench.cells.plan import Plan, read_plan
from tdgbench.cells.protocol import MEASURED_ON, protocol_settings
from tdgbench.cells.record import Record
from tdgbench.packs import manifest, unpacked
from tdgbench.packs.checklist import Item, checklist
from tdgbench.packs.manifest import Manifest
from tdgbench.report.scores import main_scores
from tdgbench.tables.build import Tables, build_tables
from tdgbench.tables.cell import Cell, finished_cells
from tdgbench.tables.long_table import method_label
from tdgbench.tables.measures import AVERAGE, COLUMNS, HOURS, OVERALL, as_text
from tdgbench.tables.palette import image_values

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
    cells: list[Cell]

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
class Row:
    """A row of a leaderboard: a method's column on one scene, or on average over those of a pack.

    settings: of its protocol. scores: text, sort, bold, title, verdict and published number of each of COLUMNS.
    """

    pack: Pack
    protocol: str
    settings: dict[str, Any]
    dataset: str
    scene: str
    method: str
    column: str  # the method with its points and overrides
    records: list[Record]
    scores: list[dict[str, Any]]
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
    tables = build_tables(folder)
    cells = finished_cells(folder, tables.records)
    return Pack(path.name, path.stat().st_size, sha256, content, plan, items, tables, cells)


def rows_of(pack: Pack, truths: Mapping[Path, int]) -> list[Row]:
    """Return the rows of a pack: scenes that a method's column has a finished cell of, and averages over several.

    truths: `truth_groups` of the cells of all packs.
    """
    main = pack.tables.main
    protocols = main.set_index(["dataset", "scene", "method"])["protocol"].to_dict()
    scenes = {(cell.record.dataset, cell.record.scene) for cell in pack.cells}
    several = {dataset for dataset, _ in scenes if sum(other == dataset for other, _ in scenes) > 1}
    rows = []
    for place in main_scores(pack.tables)["rows"]:
        dataset, scene, column = key = place["key"]
        is_shown = dataset in several if scene == AVERAGE else (dataset, scene) in scenes
        if is_shown and any(cell["text"] != "n/a" for cell in place["cells"]):
            numbers = zip(COLUMNS, place["cells"], strict=True)
            scores = [{**cell, "published": _published(pack, key, metric)} for metric, cell in numbers]
            cells = [
                cell
                for cell in pack.cells
                if method_label(cell.record, with_init=True) == column
                and cell.record.dataset == dataset
                and scene in (cell.record.scene, AVERAGE)
            ]
            records, found = [cell.record for cell in cells], frozenset(truths[cell.folder] for cell in cells)
            settings, method = protocol_settings(records[0].config), records[0].method
            rows.append(Row(pack, protocols[key], settings, dataset, scene, method, column, records, scores, found))
    return rows


def _published(pack: Pack, key: tuple[str, str, str], metric: str) -> str:
    """Return the published number beside one of ours, with its verdict; empty without."""
    table = pack.tables.difference
    if table is None:
        return ""
    dataset, scene, column = key
    found = table[(table["dataset"] == dataset) & (table["scene"] == scene) & (table["method"] == column)]
    found = found[found["metric"] == metric]
    if found.empty or np.isnan(found.iloc[0]["published"]):
        return ""
    text = as_text(metric, found.iloc[0]["published"], scene)
    verdict = "" if metric == HOURS.name or np.isnan(found.iloc[0]["difference"]) else f", {found.iloc[0]['verdict']}"
    return f"published {text}{verdict}"
