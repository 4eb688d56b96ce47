"""The evidence for a claim: tables, and the trained cells behind ours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple, TypeVar

import pandas as pd
from pydantic import ConfigDict

from tdgbench.cells.folder import shared_content
from tdgbench.cells.plan import Plan
from tdgbench.cells.prior_sources import SOURCES
from tdgbench.cells.record import Record, no_records
from tdgbench.scenes.registry import DATASETS
from tdgbench.tables import methods
from tdgbench.tables.likeness import Trainings, setups, was_disturbed
from tdgbench.tables.long_table import cell_rows, iterations_in_words, planned_iterations, scene_rows, with_averages
from tdgbench.tables.measures import AVERAGE, HOURS, KEYS, OVERALL
from tdgbench.tables.overrides import overrides_of
from tdgbench.tables.results import Cell, read_results
from tdgbench.tables.statistics import seed_values
from tdgbench.text import named

HOLDS, FAILS, UNDECIDED = "holds", "fails", "undecided"
THE_PAPER = "TDg"  # of claims that name none
Cells = TypeVar("Cells", bound=tuple[Cell, ...])


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim of `paper_tables/claims.yaml`: its words, its check, and the numbers that the check reads.

    Text that is a number is as printed, with the digits that are known. The docstring of a check says what it reads.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    id: str
    said: str
    where: str
    check: str
    paper: str = THE_PAPER
    reason: str = ""  # of `margins`
    note: str = ""  # follows our finding
    unprinted: str = ""  # number that the paper does not print
    gain: str = ""  # `overall`: the average gain is compared with the spread between papers
    metric: str = ""
    metrics: list[str] = field(default_factory=list)
    dataset: str | None = None  # None: all of them
    methods: list[str] = field(default_factory=list)
    against: list[str] = field(default_factory=list)  # methods
    margins: dict[str, float] = field(default_factory=dict)  # by quantity
    stages: dict[str, int] = field(default_factory=dict)  # by method, of one modality each; one is compared (default 1)
    percent: str = ""
    averages: dict[str, str] = field(default_factory=dict)  # by method
    minutes: str = ""
    exceptions: dict[str, int] = field(default_factory=dict)  # by metric
    most: float = 0.0
    drop: float = 0.0  # dB
    better: str = ""  # initial points
    level: float = 0.0
    window: float = 0.0
    share: float = 0.0


class JudgedClaim(NamedTuple):
    """A row of claims.csv: a claim with the verdict and its grounds by the published tables and by our results."""

    id: str
    said: str
    where: str
    paper: str
    published: str
    published_seen: str
    ours: str
    ours_seen: str


class MissingError(Exception):
    """The evidence lacks a number that a claim needs."""


class Finding(NamedTuple):
    """The verdict on a claim, and its grounds in words."""

    verdict: str
    grounds: str

    @classmethod
    def decided(cls, surely: bool, possibly: bool, grounds: str) -> Finding:
        """Return the finding on a claim that holds surely, or only possibly, by what is known of its numbers."""
        return cls(HOLDS if surely else UNDECIDED if possibly else FAILS, grounds)


@dataclass(frozen=True)
class ClaimEvidence:
    """A main table (method, dataset, group, scene, metric, value, bold) and an ablation (method, init, metric, value).

    printed: whether the values were rounded for print, so that each is known to half a unit only. cells: the cells
    behind our tables. note: the cells of the main table, in words. equal_sized: cells that have the number of Gaussians
    that was asked for; no table and no other claim reads them. by_seed: `seed_values` of our main table.
    not_counted: methods of cells of ours that count for no claim, with a sentence for each reason. failed: by method,
    the number of its trainings that failed (but for disk, memory or device), for its failures are outcomes, too.
    """

    main: pd.DataFrame
    ablation: pd.DataFrame | None
    printed: bool
    cells: tuple[Cell, ...] = ()
    note: str = ""
    equal_sized: tuple[Cell, ...] = ()
    by_seed: pd.DataFrame | None = None
    not_counted: tuple[tuple[str, str], ...] = ()
    failed: Mapping[str, int] = field(default_factory=dict)

    @property
    def overall(self) -> str:
        """The scene that stands for all: with one data set its average, which is the average over all scenes."""
        if (self.main["scene"] == OVERALL).any() or len(set(self.main["dataset"]) - {""}) != 1:
            return OVERALL
        return AVERAGE

    @property
    def is_of_one_seed(self) -> bool:
        """True if a number of our main table is of one seed."""
        seeds: dict[object, set[int]] = {}
        for cell in self.published_cells:
            seeds.setdefault((cell.record.method, cell.dataset_and_scene), set()).add(cell.record.seed)
        return min(map(len, seeds.values()), default=2) < 2

    @property
    def is_of_paper(self) -> bool:
        """True if the main table has the paper's scenes and no others."""
        return set(self.main["dataset"]) - {""} <= set(DATASETS.values())

    @cached_property
    def values(self) -> dict[tuple[str, str, str], list[float]]:
        """The numbers of the main table that are there, by method, scene and metric."""
        found: dict[tuple[str, str, str], list[float]] = {}
        for row in self.main.dropna(subset=["value"]).itertuples():
            found.setdefault((row.method, row.scene, row.metric), []).append(float(row.value))
        return found

    @cached_property
    def placed(self) -> list[tuple[str, Cell]]:
        """The cells, each with what it shares with those that it is compared with (`likeness.setups`)."""
        return list(zip(setups([cell.record for cell in self.cells]), self.cells, strict=True))

    @cached_property
    def published_lengths(self) -> dict[tuple[str, str], int]:
        """By method and setup, the fewest iterations of the paper's method and the most of its baseline.

        The paper has 10 000 and 30 000.
        """
        lengths: dict[tuple[str, str], int] = {}
        pick = dict(zip(methods.paper_pair(), (min, max), strict=True))
        for setup, cell in self.placed:
            method, length = cell.record.method, cell.planned_iterations
            if method in pick and cell.record.init == "colmap":
                lengths[method, setup] = pick[method](lengths.get((method, setup), length), length)
        return lengths

    @cached_property
    def published_pairs(self) -> tuple[list[tuple[Cell, Cell]], str]:
        """The cells of the main table, and in words which are left out: see `decisive`.

        They are of the paper's method and its baseline from COLMAP points, at `published_lengths`. Only setups and
        seeds that both methods have count, and none where the paper's method trains for longer.
        """
        new: dict[tuple[str, int], Cell] = {}
        old: dict[tuple[str, int], Cell] = {}
        for setup, cell in self.placed:
            method = cell.record.method
            if cell.record.init == "colmap" and self.published_lengths.get((method, setup)) == cell.planned_iterations:
                chosen = new if method == methods.paper_pair().method else old
                chosen.setdefault((setup, cell.record.seed), cell)
        both = [(cell, old[place]) for place, cell in new.items() if place in old]
        return decisive([pair for pair in both if pair[0].planned_iterations <= pair[1].planned_iterations])

    @property
    def published_cells(self) -> list[Cell]:
        """The cells of `published_pairs`, method by method."""
        return [pair[side] for side in (0, 1) for pair in self.published_pairs[0]]


def evidence_of(experiments: Iterable[Path]) -> ClaimEvidence:
    """Return our evidence: every cell of the experiments that has scores.

    Cells with overrides of a method, a prior or an init do not count: they are not what the YAML files have.
    Cells whose prior is made from the sparse points do not: these may come from RGB images, and TDg has thermal ones.
    A number of a method over unlike trainings is n/a.
    Raises ValueError for a folder without records.
    """
    found: list[list[Cell]] = []
    failed: list[Record] = []
    for folder in experiments:
        results = read_results(folder)
        if not results.cells:
            raise no_records(folder)
        found.append(results.finished)
        failed += [one for one in results.records if one.failure and not overrides_of(one)]
    cells: list[Cell] = []
    dropped: dict[tuple[str, str], int] = {}
    for cell in _each_once(found):
        if why := _why_not_counted(cell.record):
            place = cell.record.method, why
            dropped[place] = dropped.get(place, 0) + 1
        else:
            cells.append(cell)
    sized = [cell for cell in cells if cell.record.setting("budget.gaussians") is not None]
    equal = [c for c in sized if c.record.gaussians.get("thermal") == c.record.setting("budget.gaussians")]
    cells = [cell for cell in cells if cell not in sized]
    evidence = ClaimEvidence(pd.DataFrame(columns=KEYS), None, False, tuple(cells), equal_sized=tuple(equal))
    chosen = evidence.published_cells
    plan = Plan(methods=list(methods.paper_pair()) if chosen else [])
    rows = _with_times_of_one_machine(cell_rows([replace(cell.record, variant="") for cell in chosen], plan), chosen)
    by_seed = seed_values(rows) if chosen else None
    trainings = Trainings([cell.record for cell in chosen], attrgetter("method"), is_ranking_unlike=False)
    main, *_ = trainings.set_apart(with_averages(scene_rows(rows)))
    note = "; ".join(filter(None, [_lengths(chosen), evidence.published_pairs[1]]))
    sentences = (
        (method, f"{n} training{'s' * (n > 1)} of {methods.label(method)} count{'s' * (n == 1)} for no claim: {why}")
        for (method, why), n in dropped.items()
    )
    return replace(
        evidence, main=main, note=note, by_seed=by_seed, not_counted=tuple(sentences), failed=_outcomes(failed, cells)
    )


def _outcomes(failed: Iterable[Record], cells: Iterable[Cell]) -> Counter[str]:
    """Return the number of trainings of each method that failed by themselves, and were not made again."""

    def place(record: Record) -> tuple[object, ...]:
        return (record.method, record.init, record.dataset, record.scene, record.seed, planned_iterations(record))

    made = {place(cell.record) for cell in cells}
    by_itself = [
        one for one in failed if one.failure and one.failure.phase == "train" and not one.failure.of_environment
    ]
    return Counter(one.method for one in by_itself if place(one) not in made)


def _each_once(experiments: Sequence[Sequence[Cell]]) -> list[Cell]:
    """Return the cells, each training once that several experiments hold.

    The experiment with most scores comes first, of equal ones that of a free machine; so times of two methods are of
    one machine.
    """

    def fault(cells: Sequence[Cell]) -> tuple[float, float]:
        count = max(len(cells), 1)
        busy = sum(was_disturbed(cell.record) for cell in cells)
        return sum(len(cell.record.missing) for cell in cells) / count, busy / count

    found: dict[object, Cell] = {}
    for cell in (cell for cells in sorted(experiments, key=fault) for cell in cells):
        record, content = cell.record, shared_content(cell.record)
        place = record.method, record.init, *cell.dataset_and_scene, cell.planned_iterations
        found.setdefault((*place, content or str(cell.folder)), cell)  # of any seed: a copy is no further training
    return list(found.values())


def _with_times_of_one_machine(rows: pd.DataFrame, cells: Sequence[Cell]) -> pd.DataFrame:
    """Return `cell_rows` without the times of scenes whose cells ran on several machines, or on a busy one."""
    machines: dict[tuple[str, str], set[tuple[str, ...]]] = {}
    for cell in cells:
        machines.setdefault(cell.dataset_and_scene, set()).add(cell.machine)
    several = {place for place, found in machines.items() if len(found) > 1}
    several |= {cell.dataset_and_scene for cell in cells if was_disturbed(cell.record)}
    places = zip(rows["dataset"], rows["scene"], rows["metric"], strict=True)
    dropped = [metric == HOURS.name and (dataset, scene) in several for dataset, scene, metric in places]
    rows.loc[dropped, ["value", "reason"]] = [
        float("nan"),
        "times of several or busy machines",
    ]
    return rows


def decisive(compared: Sequence[Cells]) -> tuple[list[Cells], str]:
    """Return which of the compared cells decide a claim, and in words which are left out; empty if none are.

    Those of captures, unless all are of built-in scenes, and of these, the longest trainings.
    """
    captures = [cells for cells in compared if not _is_built_in(cells)]
    kept = captures or list(compared)
    lengths = [tuple(cell.planned_iterations for cell in cells) for cells in kept]
    longest = max(lengths, key=lambda each: (sum(each), each), default=())
    shorter = [" and ".join(map(str, sorted(set(each)))) for each in sorted({*lengths} - {longest})]
    left_out = ["built-in scenes"] if len(kept) < len(compared) else []
    left_out += [f"trainings of {' or '.join(shorter)} iterations"] if shorter else []
    chosen = [cells for cells, each in zip(kept, lengths, strict=True) if each == longest]
    return chosen, f"left out: {', '.join(left_out)}" if left_out else ""


def on_built_in(finding: Finding, cells: Iterable[Cell]) -> Finding:
    """Return the finding on cells that `decisive` chose: on built-in scenes undecided, with what it is there."""
    cells = list(cells)
    if not cells or not _is_built_in(cells):
        return finding
    known = {methods.label(c.record.method) for c in cells if c.record.prior_source.words}  # of all that counts
    prior = f" and the depth prior of {named(sorted(known))} is made from {SOURCES['truth'].words}" if known else ""
    verdict = f"is {UNDECIDED}" if finding.verdict == UNDECIDED else finding.verdict
    where = f"the scenes are built in{prior}: no evidence on a paper; there it {verdict}"
    return Finding(UNDECIDED, f"{where}: {finding.grounds}")


def _is_built_in(cells: Iterable[Cell]) -> bool:
    return all(cell.record.is_of_built_in_scene for cell in cells)


def _why_not_counted(record: Record) -> str:
    """Return why a cell counts for no claim; empty if it does."""
    if not record.prior_source.counts:
        return f"the depth prior is made from {record.prior_source.in_full}"
    if any(override.startswith("prior") for override in record.variant.split(",")):
        return "their sweep has several priors"
    return "options are not those of the method's file" if overrides_of(record) else ""


def _lengths(cells: Sequence[Cell]) -> str:
    """Return `4 scenes; TDg at 1000, MSMG at 3000 iterations`; empty without cells."""
    if not cells:
        return ""
    parts = []
    for method in methods.paper_pair():
        records = [cell.record for cell in cells if cell.record.method == method]
        parts.append(f"{methods.label(method)} at {iterations_in_words(records)}")
    scenes = len({cell.dataset_and_scene for cell in cells})
    return f"{scenes} scene{'s' if scenes > 1 else ''}; {', '.join(parts)} iterations"
