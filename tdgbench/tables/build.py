"""Build an experiment's tables: main.{csv,tex}; with published numbers difference.csv and between_papers.csv.

findings.txt says in sentences what they hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Record
from tdgbench.files import write_text
from tdgbench.present.grid import Grid
from tdgbench.scenes.registry import DATASETS
from tdgbench.tables.as_csv import to_csv
from tdgbench.tables.between_papers import against_others, between_papers
from tdgbench.tables.columns import own_columns
from tdgbench.tables.comparisons import MethodComparison, compare_methods, comparison_tables, with_bold
from tdgbench.tables.equal_data import equal_scenes
from tdgbench.tables.findings import findings_of_ablation, findings_of_methods
from tdgbench.tables.grids import ABLATION_KEYS, ablation_grid, main_grid
from tdgbench.tables.latex import ablation_table, main_table
from tdgbench.tables.likeness import (
    Trainings,
    disturbed_notes,
    is_selected,
    selected_notes,
    times_at_once,
    was_disturbed,
)
from tdgbench.tables.long_table import (
    ABOUT,
    cell_rows,
    is_random,
    method_label,
    scene_rows,
    with_averages,
    with_protocols,
)
from tdgbench.tables.measures import ABLATION, ASKED, AVERAGE, COLUMNS, HOURS, KEYS, OVERALL, further
from tdgbench.tables.overrides import override_notes
from tdgbench.tables.palette import IMAGES, with_image_values
from tdgbench.tables.published import published_ablation, published_main, with_papers_averages
from tdgbench.tables.readings import effects, reading_cells, reading_label, readings
from tdgbench.tables.results import Results, read_results
from tdgbench.tables.statistics import intervals, with_seeds
from tdgbench.tables.verdicts import against_published

INITS = ("random", "colmap")  # of the paper's Table 2
CSV_COLUMNS = [
    *KEYS, "value", "bold", "reason", "seeds", "std", "ci95_low", "ci95_high", *ABOUT, "training", IMAGES,
]  # fmt: skip
COLUMN_OF = partial(method_label, with_init=True)


class TableOptions(NamedTuple):
    """What a reader asks of tables. columns: measures of the main table; none: the usual ones."""

    columns: tuple[str, ...] = ()
    is_ranking_unlike: bool = False  # unlike trainings are ranked and averaged


USUAL = TableOptions()


@dataclass(frozen=True, kw_only=True)
class Tables:
    """The tables of an experiment. difference and papers are None where nothing is published for these scenes."""

    results: Results  # plan and cells behind the tables
    main: pd.DataFrame
    difference: pd.DataFrame | None
    findings: list[str]  # in sentences
    comparisons: Sequence[MethodComparison] = ()  # of methods with their baselines
    readings: pd.DataFrame | None = None  # by method and length; of table=readings alone
    effects: pd.DataFrame | None = None
    notes: Sequence[str] = ()  # on unlike trainings
    columns: tuple[str, ...] = ()  # as `TableOptions`

    @property
    def is_ablation(self) -> bool:
        return self.results.plan.table == "ablation"

    @property
    def records(self) -> list[Record]:
        return self.results.records

    @property
    def problems(self) -> list[str]:
        return self.results.problems

    @property
    def folder(self) -> Path:
        return self.results.tables

    @property
    def papers(self) -> pd.DataFrame | None:
        """The spread between papers."""
        return None if self.difference is None else between_papers()

    @cached_property
    def grid(self) -> Grid:
        """The main table as readers see it."""
        with own_columns(self.results.plan):
            if self.is_ablation:
                return ablation_grid(self.main, self.difference, self.notes)
            return main_grid(self.main, self.difference, self.columns, self.notes)

    @property
    def latex(self) -> str:
        records = [one.record for one in self.results.finished]
        with own_columns(self.results.plan):
            if self.is_ablation:
                return ablation_table(self.main, self.grid, records)
            return main_table(self.main, self.grid, self.columns, records)


def build_tables(experiment: Path, options: TableOptions = USUAL) -> Tables:
    """Build and write the tables of an experiment.

    A record that cannot be read gives n/a with the reason, and is one of the results' `problems`; so is a mean of
    unlike trainings. Raises ValueError for an empty folder, naming it, and for columns that no table has.
    """
    results = read_results(experiment, of_last_run=True)
    with own_columns(results.plan):
        known = *COLUMNS, *further(), *ASKED
        unknown = [name for name in options.columns if name not in known]
        if unknown:
            own = "a metric of yours: `tdgbench score` first"
            raise ValueError(f"no column {', '.join(unknown)} ({own}); known are {', '.join(known)}")
        tables = _ablation(results, options) if results.plan.table == "ablation" else _main(results, options)
        _write(tables)
    return tables


def _main(results: Results, options: TableOptions) -> Tables:
    """Build the main table and what goes with it; with table=readings, those of the readings as well."""
    records = results.records
    cells = cell_rows(records, results.plan, asked=[name for name in ASKED if name in options.columns])
    main, by_seed = with_seeds(with_protocols(with_averages(scene_rows(cells)), records), cells)
    main = main.merge(intervals(results.finished), on=KEYS, how="left")
    is_time = main["metric"] == HOURS.name
    main.loc[main["value"].isna() | is_time, ["ci95_low", "ci95_high"]] = float("nan")  # no mean over views
    main, notes, problems = Trainings(records, COLUMN_OF, options.is_ranking_unlike).set_apart(main)
    finished = [cell.record for cell in results.finished]
    equal = equal_scenes(finished)
    main = with_bold(with_image_values(main, records, COLUMN_OF), by_seed, ["dataset", "scene"])[CSV_COLUMNS]
    if any(map(was_disturbed, finished)):
        main.loc[is_time, "bold"] = False
    comparisons = compare_methods(cells, main, results.finished, equal)
    busy = {(COLUMN_OF(one), *place) for one in finished if was_disturbed(one)
            for place in ((one.dataset, one.scene), (one.dataset, AVERAGE), ("", OVERALL))}  # fmt: skip
    is_busy = [place in busy for place in zip(main["method"], main["dataset"], main["scene"], strict=True)]
    main.loc[is_time & main["value"].notna() & np.array(is_busy), "reason"] = "its mean has times of a busy machine"
    of_paper = main["dataset"].isin(DATASETS.values()).any()
    difference = None
    if of_paper:
        difference = against_published(with_papers_averages(main), published_main(), KEYS, records, COLUMN_OF)
    by_length, changes = None, None
    if results.plan.table == "readings":
        numbers = reading_cells(records)
        by_length, changes = (with_image_values(one(numbers), records, reading_label) for one in (readings, effects))
    return Tables(
        results=replace(results, problems=[*results.problems, *problems]), main=main, difference=difference,
        findings=findings_of_methods(main, difference, comparisons, changes, equal, finished), comparisons=comparisons,
        readings=by_length, effects=changes, columns=options.columns,
        notes=[
            *notes, *override_notes(finished, COLUMN_OF), *selected_notes(finished, COLUMN_OF),
            *times_at_once(finished), *disturbed_notes(finished),
        ],
    )  # fmt: skip


def _ablation(results: Results, options: TableOptions) -> Tables:
    records, plan = results.records, results.plan
    if options.columns:
        raise ValueError(f"{results.folder} is an ablation, whose columns are those of the paper's")
    trainings = Trainings(records, lambda record: _of_init(record.init, method_label(record, with_init=False)),
                          options.is_ranking_unlike)  # fmt: skip
    main, notes = ablation_rows(records, plan, trainings)
    datasets = {s.dataset for s in plan.scenes} | {r.dataset for r in records}
    of_paper = datasets <= set(DATASETS.values())  # a mean over other scenes as well is not the published one
    difference = None
    if of_paper:
        published = published_ablation()  # its row of random points is that of each kind, as the paper names none
        random, kinds = published[published["init"] == "random"], {*filter(is_random, main["init"])} - {"random"}
        published = pd.concat([published, *(random.assign(init=kind) for kind in sorted(kinds))])
        difference = against_published(main, published, ABLATION_KEYS, records, partial(method_label, with_init=False))
    finished = [cell.record for cell in results.finished]
    findings = findings_of_ablation(main, difference, finished)
    notes += override_notes(finished, partial(method_label, with_init=False))
    return Tables(results=results, main=main, difference=difference, findings=findings, notes=notes)


def _write(tables: Tables) -> None:
    """Write every table that there is into the folder; remove those of cells that were removed."""
    found: dict[str, pd.DataFrame | None] = {
        "main": _with_selected(tables), "readings": tables.readings, "effects": tables.effects,
        "difference": tables.difference, "between_papers": tables.papers, "compared": None, "paired": None,
        "others": None if tables.papers is None or tables.is_ablation else against_others(
            tables.main, tables.records, COLUMN_OF),
        **comparison_tables(tables.comparisons),
    }  # fmt: skip
    tables.folder.mkdir(parents=True, exist_ok=True)
    for name, table in found.items():
        if table is None:
            (tables.folder / f"{name}.csv").unlink(missing_ok=True)
        else:
            write_text(tables.folder / f"{name}.csv", to_csv(table))
    write_text(tables.folder / "main.tex", tables.latex)
    write_text(tables.folder / "findings.txt", "".join(f"{sentence}\n" for sentence in tables.findings))


def _with_selected(tables: Tables) -> pd.DataFrame:
    """Return the main table; its column `training` tells scores that test views chose."""
    selected = {COLUMN_OF(one.record) for one in tables.results.finished if is_selected(one.record)}
    main, rows = tables.main.copy(), tables.main["method"].isin(selected)
    told = [f"{text}; " * bool(text) + "checkpoint: chosen by test views" for text in main.loc[rows, "training"]]
    main.loc[rows, "training"] = told
    return main


def _of_init(init: str, column: str) -> str:
    """Return the name of an ablation's row."""
    return f"{column} ({init})"


def ablation_rows(records: list[Record], plan: Plan, trainings: Trainings) -> tuple[pd.DataFrame, list[str]]:
    """Return method, init, metric, value, bold, points, seeds, std, reason: means over all scenes, per init; and notes.

    The best init is bold, and those that cannot be told from it. points: origin of the initial ones. Scores of training
    views show overfitting; scores of the RGB model show what random points do to it.
    """
    parts, seeds = [], []
    inits = dict.fromkeys([*plan.inits, *(r.init for r in records)]) or INITS
    for init in sorted({*INITS, *inits}, key=lambda name: (not is_random(name), name)):
        cells = cell_rows(records, plan, init)
        rows = with_averages(scene_rows(cells))
        origins = dict.fromkeys(str(r.init_points["how"]) for r in records if r.init == init and "how" in r.init_points)
        datasets = set(rows["dataset"]) - {""}
        chosen = rows[(rows["scene"] == (OVERALL if len(datasets) > 1 else AVERAGE)) & rows["metric"].isin(ABLATION)]
        chosen, by_seed = with_seeds(chosen, cells)
        seeds.append(by_seed)
        parts.append(chosen.assign(init=init, points="; ".join(origins)))
    table = pd.concat(parts, ignore_index=True)
    names = table.assign(method=[_of_init(row.init, row.method) for row in table.itertuples()])
    named, notes, _ = trainings.set_apart(names)
    table = named.assign(method=table["method"])
    table = with_bold(table, pd.concat(seeds, ignore_index=True), ["method"])
    order = {name: -i for i, name in enumerate(table["method"].unique())}  # TDg first, as the paper's Table 2
    table = table.sort_values("method", key=lambda c: c.map(order), kind="stable").reset_index(drop=True)
    table = table[[*ABLATION_KEYS, "value", "bold", "points", "seeds", "std", "reason", "training"]]
    return with_image_values(table, records, partial(method_label, with_init=False)), notes
