"""Build an experiment's tables: main.{csv,tex}; with published numbers difference.csv and between_papers.csv.

findings.txt says in sentences what they hold.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Record, no_records
from tdgbench.files import write_text
from tdgbench.scenes.registry import DATASETS
from tdgbench.tables import methods
from tdgbench.tables.as_csv import to_csv
from tdgbench.tables.between_papers import against_others, between_papers, with_other_papers
from tdgbench.tables.findings import findings_of_ablation, findings_of_methods
from tdgbench.tables.latex import ablation_table, main_table
from tdgbench.tables.long_table import method_label, scene_rows, with_averages, with_bold, with_protocols
from tdgbench.tables.measures import ABLATION, AVERAGE, KEYS, OVERALL
from tdgbench.tables.palette import COLUMN, with_image_values
from tdgbench.tables.published import published_ablation, published_main
from tdgbench.tables.readings import effects, reading_cells, readings
from tdgbench.tables.records import Results, read_results
from tdgbench.tables.statistics import MethodComparison, intervals, over_seeds, paired_tests, speed_table
from tdgbench.tables.verdicts import ScoreVerdict, verdict

INITS = ("random", "colmap")  # of the paper's Table 2
ABLATION_KEYS = ["method", "init", "metric"]


@dataclass(frozen=True, kw_only=True)
class Tables:
    """The tables of an experiment. difference and papers are None where nothing is published for these scenes."""

    kind: str  # main, ablation or readings
    main: pd.DataFrame
    latex: str
    difference: pd.DataFrame | None
    folder: Path
    records: list[Record]  # the cells behind the tables
    findings: list[str]  # in sentences
    problems: list[str]  # what could not be read
    comparisons: Sequence[MethodComparison] = ()  # of methods with their baselines
    papers: pd.DataFrame | None = None  # spread between papers
    readings: pd.DataFrame | None = None  # by method and length; of table=readings alone
    effects: pd.DataFrame | None = None


def build_tables(experiment: Path) -> Tables:
    """Build and write the tables of an experiment. Raises ValueError, naming the folder, if it is empty.

    A record that cannot be read gives n/a with the reason, and is one of the tables' `problems`.
    """
    results = read_results(experiment)
    if not results.records and not results.plan.scenes:
        raise no_records(experiment)
    tables = (_ablation if results.plan.table == "ablation" else _main)(results, experiment)
    _write(tables)
    return tables


def _main(results: Results, experiment: Path) -> Tables:
    """Build the main table and what goes with it; with table=readings, those of the readings as well."""
    records, plan = results.records, results.plan
    bold = with_bold(with_averages(scene_rows(records, plan)))
    main = bold.merge(over_seeds(records, plan), on=KEYS, how="left")
    main["seeds"] = main["seeds"].fillna(0).astype(int)
    main = with_protocols(main.merge(intervals(records, experiment), on=KEYS, how="left"), records)
    main = with_image_values(main, records, partial(method_label, with_init=True))
    of_paper = main["dataset"].isin(DATASETS.values()).any()
    against = with_verdicts(difference(main, published_main(), KEYS), main, KEYS) if of_paper else None
    pairs = [pair for pair in methods.pairs() if {*pair} <= {*main["method"]}]
    comparisons = [MethodComparison(pair, paired_tests(main, pair), speed_table(main, pair)) for pair in pairs]
    cells = reading_cells(records) if plan.table == "readings" else None
    changes = None if cells is None else effects(cells)
    return Tables(
        kind=plan.table, main=main, latex=main_table(main), difference=against, folder=experiment / "tables",
        records=records, findings=findings_of_methods(main, against, comparisons, changes), problems=results.problems,
        comparisons=comparisons, papers=None if against is None else between_papers(),
        readings=None if cells is None else with_image_values(readings(cells), records),
        effects=None if changes is None else with_image_values(changes, records),
    )  # fmt: skip


def _ablation(results: Results, experiment: Path) -> Tables:
    records, plan = results.records, results.plan
    main = ablation_rows(records, plan)
    datasets = {s.dataset for s in plan.scenes} | {r.dataset for r in records}
    of_paper = datasets <= set(DATASETS.values())  # a mean over other scenes as well is not the published one
    differences = difference(main, ablation_as_published(main["init"].unique()), ABLATION_KEYS)
    against = with_verdicts(differences, main, ABLATION_KEYS) if of_paper else None
    return Tables(
        kind="ablation", main=main, latex=ablation_table(main), difference=against, folder=experiment / "tables",
        records=records, findings=findings_of_ablation(main, against), problems=results.problems,
        papers=None if against is None else between_papers(),
    )  # fmt: skip


def _write(tables: Tables) -> None:
    """Write every table into its folder. Files of the paper's pair have plain names; others name their method."""
    files = {"main.csv": to_csv(tables.main), "main.tex": tables.latex}
    if tables.readings is not None and tables.effects is not None:
        files["readings.csv"], files["effects.csv"] = to_csv(tables.readings), to_csv(tables.effects)
    if tables.difference is not None:
        files["difference.csv"] = to_csv(tables.difference)
    if tables.papers is not None:
        files["between_papers.csv"] = to_csv(tables.papers)
        if tables.kind != "ablation":
            files["others.csv"] = to_csv(against_others(tables.main))
    for pair, paired, speed in tables.comparisons:
        suffix = "" if pair == methods.paper_pair() else f"_{pair.method}"
        files |= {f"{name}{suffix}.csv": to_csv(t) for name, t in (("paired", paired), ("speed", speed)) if not t.empty}
    files["findings.txt"] = "".join(f"{sentence}\n" for sentence in tables.findings)
    tables.folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_text(tables.folder / name, text)


def difference(ours: pd.DataFrame, published: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return one row per published number: keys, ours, published, difference (NaN where ours is n/a), reason.

    >>> ours, paper = (pd.DataFrame({"method": ["tdg"], "value": [value]}) for value in (26.5, 26.25))
    >>> difference(ours, paper, ["method"])[["ours", "published", "difference"]].values.tolist()
    [[26.5, 26.25, 0.25]]
    """
    mine = ours[[*keys, "value", *(["reason"] if "reason" in ours else [])]].rename(columns={"value": "ours"})
    merged = published[[*keys, "value"]].rename(columns={"value": "published"}).merge(mine, on=keys, how="left")
    merged["difference"] = merged["ours"] - merged["published"]
    if "reason" not in merged:
        merged["reason"] = ""
    merged["reason"] = merged["reason"].fillna("no such cell in our results")
    return merged[[*keys, "ours", "published", "difference", "reason"]]


def with_verdicts(differences: pd.DataFrame, main: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return the differences with our std, seeds and image_values, fields of ScoreVerdict, other papers' numbers."""
    merged = differences.merge(main[[*keys, "std", "seeds", COLUMN]], on=keys, how="left")
    of_images = merged.pop(COLUMN).fillna("")
    merged["seeds"] = merged["seeds"].fillna(0).astype(int)
    judged = [
        verdict(r.metric, getattr(r, "scene", OVERALL), r.ours, r.published, r.std, r.seeds)
        for r in merged.itertuples()
    ]
    verdicts = pd.DataFrame(judged, columns=list(ScoreVerdict._fields), index=merged.index)
    verdicts = verdicts[["margin", "ci90_low", "ci90_high", "verdict", "seeds_needed", "undecided_because"]]
    return with_other_papers(pd.concat([merged, verdicts], axis=1)).assign(**{COLUMN: of_images})


def ablation_rows(records: list[Record], plan: Plan) -> pd.DataFrame:
    """Return method, init, metric, value, bold, points, seeds, std, reason: means over all scenes, per init.

    The best init is bold. points: origin of the initial ones. Scores of training views show overfitting; scores of the
    RGB model show what random points do to it.
    """
    parts = []
    inits = dict.fromkeys([*plan.inits, *(r.init for r in records)]) or INITS
    for init in sorted({*INITS, *inits}, key=lambda name: (not name.startswith("random"), name)):
        rows = with_averages(scene_rows(records, plan, init))
        rows = rows.merge(over_seeds([r for r in records if r.init == init], plan, init), on=KEYS, how="left")
        origins = dict.fromkeys(str(r.init_points["how"]) for r in records if r.init == init and "how" in r.init_points)
        datasets = set(rows["dataset"]) - {""}
        chosen = rows[rows["scene"] == (OVERALL if len(datasets) > 1 else AVERAGE)]
        parts.append(chosen[chosen["metric"].isin(ABLATION)].assign(init=init, points="; ".join(origins)))
    table = pd.concat(parts, ignore_index=True)
    order = {name: -i for i, name in enumerate(table["method"].unique())}  # TDg first, as the paper's Table 2
    table = table.sort_values("method", key=lambda c: c.map(order), kind="stable").reset_index(drop=True)
    groups = table.groupby(["method", "metric"])["value"]
    table["bold"] = (table["value"] == groups.transform("max")) & (groups.transform("nunique") > 1)
    table = table[[*ABLATION_KEYS, "value", "bold", "points", "seeds", "std", "reason"]]
    return with_image_values(table, records, partial(method_label, with_init=False))


def ablation_as_published(inits: Iterable[str]) -> pd.DataFrame:
    """Return Table 2 with its row of random points repeated for each kind of them: the paper does not name its kind."""
    published = published_ablation()
    kinds = [init for init in inits if init.startswith("random")]
    random = published[published["init"] == "random"]
    return pd.concat([published[published["init"] != "random"], *(random.assign(init=kind) for kind in kinds)])
