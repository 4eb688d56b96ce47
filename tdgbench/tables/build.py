"""From an experiment's folder to its tables: main.csv, main.tex; where something is published, difference.csv and
between_papers.{csv,tex}.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from tdgbench.bench.plan import Plan, read_plan
from tdgbench.bench.record import Record, read_all
from tdgbench.files import write_text
from tdgbench.scenes.registry import DATASETS
from tdgbench.tables.between_papers import all_averages, between_papers, with_others
from tdgbench.tables.claims import Evidence, check_all, evidence_of, load_claims
from tdgbench.tables.difference import difference
from tdgbench.tables.latex import ablation_table, main_table, papers_table, readings_table
from tdgbench.tables.published import published_ablation, published_main
from tdgbench.tables.readings import effects, reading_cells, readings
from tdgbench.tables.results import (
    KEYS,
    METHOD_ORDER,
    OVERALL,
    TRAIN_METRICS,
    scene_rows,
    with_averages,
    with_bold,
    with_splits,
)
from tdgbench.tables.statistics import intervals, over_seeds, paired_tests, speed_ratios
from tdgbench.tables.verdicts import Verdict, verdict

INITS = ("random", "colmap")  # of the paper's Table 2
ABLATION_METRICS = ("psnr", "ssim", *TRAIN_METRICS, "rgb_psnr", "rgb_ssim")
ABLATION_KEYS = ["method", "init", "metric"]
NUMBERS = ("value", "ours", "published", "difference", "std", "low", "high", "p", "margin", "others_low", "others_high",
           "spread", "printed", "mean", "tolerance", "change")  # fmt: skip


@dataclass
class Tables:
    """What was built. difference is None where nothing is published for these scenes."""

    kind: str
    main: pd.DataFrame
    latex: str
    difference: pd.DataFrame | None
    folder: Path
    records: list[Record]  # of which it was built
    paired: pd.DataFrame | None = None
    speed: pd.DataFrame | None = None
    papers: pd.DataFrame | None = None  # how far papers are apart; None where difference is
    readings: pd.DataFrame | None = None  # by method and length; of table=readings alone
    effects: pd.DataFrame | None = None


def build_tables(experiment: Path) -> Tables:
    """Build and write the tables of what is on disk. Raises ValueError if there is nothing, naming the folder."""
    records, plan = read_all(experiment), read_plan(experiment)
    if not records and not plan.scenes:
        raise ValueError(f"{experiment} holds no records; run an experiment first")
    folder = experiment / "tables"
    if plan.table == "ablation":
        main = ablation_rows(records, plan)
        datasets = {s["dataset"] for s in plan.scenes} | {r.dataset for r in records}
        of_paper = datasets <= set(DATASETS.values())  # a mean over other scenes as well is not the published one
        differences = difference(main, ablation_as_published(main["init"].unique()), ABLATION_KEYS)
        against = with_verdicts(differences, main, ABLATION_KEYS) if of_paper else None
        tables = Tables("ablation", main, ablation_table(main), against, folder, records)
    elif plan.table in ("main", "readings"):
        bold = with_bold(with_averages(scene_rows(records, plan)))
        main = bold.merge(over_seeds(records, plan), on=KEYS, how="left")
        main = with_splits(main.merge(intervals(records, experiment), on=KEYS, how="left"), records)
        of_paper = main["dataset"].isin(DATASETS.values()).any()
        against = with_verdicts(difference(main, published_main(), KEYS), main, KEYS) if of_paper else None
        tested, faster = paired_tests(main), speed_table(main)
        tables = Tables(plan.table, main, main_table(main), against, folder, records, tested, faster)
    else:
        raise ValueError(f"{experiment}: table is {plan.table!r}; it must be main, ablation or readings")
    folder.mkdir(parents=True, exist_ok=True)
    if plan.table == "readings":
        cells = reading_cells(records)
        tables.readings, tables.effects = readings(cells), effects(cells)
        write_text(folder / "readings.csv", to_csv(tables.readings))
        write_text(folder / "effects.csv", to_csv(tables.effects))
        write_text(folder / "readings.tex", readings_table(tables.readings, tables.effects))
    write_text(folder / "main.csv", to_csv(tables.main))
    write_text(folder / "main.tex", tables.latex)
    if tables.difference is not None:
        write_text(folder / "difference.csv", to_csv(tables.difference))
        tables.papers = between_papers()
        write_text(folder / "between_papers.csv", to_csv(tables.papers))
        write_text(folder / "between_papers.tex", papers_table(tables.papers))
    for name, table in (("paired", tables.paired), ("speed", tables.speed)):
        if table is not None and not table.empty:
            write_text(folder / f"{name}.csv", to_csv(table))
    return tables


def with_verdicts(differences: pd.DataFrame, main: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """The differences with std and number of seeds of ours, the fields of each Verdict, and what other papers have."""
    merged = differences.merge(main[[*keys, "std", "seeds"]], on=keys, how="left")
    merged["seeds"] = merged["seeds"].fillna(0).astype(int)
    judged = [
        verdict(r.metric, getattr(r, "scene", OVERALL), r.ours, r.published, r.std, r.seeds)
        for r in merged.itertuples()
    ]
    found = pd.DataFrame(judged, columns=list(Verdict._fields), index=merged.index).rename(columns={"word": "verdict"})
    found = found[["margin", "low", "high", "verdict", "seeds_needed", "why"]]
    return with_others(pd.concat([merged, found], axis=1))


def speed_table(main: pd.DataFrame) -> pd.DataFrame:
    """dataset, group, scene, ours, published: hours of TDg over hours of MSMG; only ratios compare across machines."""
    ours = speed_ratios(main).rename(columns={"ratio": "ours"})
    published = speed_ratios(published_main()).rename(columns={"ratio": "published"})
    return ours.merge(published, on=["dataset", "group", "scene"], how="left")


def write_claims(experiments: list[Path]) -> pd.DataFrame:
    """The paper's claims against the published tables and, with experiments, against all of their cells together;
    written to each of them, with the check of every paper's averages.

    Raises ValueError where an experiment holds nothing.
    """
    ours = evidence_of(experiments) if experiments else None
    found = check_all(load_claims(), Evidence(published_main(), published_ablation(), printed=True), ours)
    for experiment in experiments:
        folder = experiment / "tables"
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "claims.csv", found.to_csv(index=False, lineterminator="\n"))
        write_text(folder / "averages.csv", to_csv(all_averages()))
    return found


def ablation_rows(records: list[Record], plan: Plan) -> pd.DataFrame:
    """method, init, metric, value, bold, points, seeds, std, reason: means over all scenes, per init; the best init
    is bold. points: how the first points were made. The training views' scores show what overfits, the RGB model's
    what random points do to it."""
    parts = []
    inits = dict.fromkeys([*plan.inits, *(r.init for r in records)]) or INITS
    for init in sorted({*INITS, *inits}, key=lambda name: (not name.startswith("random"), name)):
        rows = with_averages(scene_rows(records, plan, init))
        rows = rows.merge(over_seeds([r for r in records if r.init == init], plan, init), on=KEYS, how="left")
        hows = dict.fromkeys(r.init_points["how"] for r in records if r.init == init and "how" in r.init_points)
        names = set(rows["dataset"]) - {""}
        chosen = rows[rows["scene"] == (OVERALL if len(names) > 1 else "Average")]
        parts.append(chosen[chosen["metric"].isin(ABLATION_METRICS)].assign(init=init, points="; ".join(hows)))
    table = pd.concat(parts, ignore_index=True)
    order = {m: i for i, m in enumerate((*METHOD_ORDER, *table["method"].unique()[::-1]))}
    table = table.sort_values("method", key=lambda c: c.map(order), kind="stable").reset_index(drop=True)
    groups = table.groupby(["method", "metric"])["value"]
    table["bold"] = (table["value"] == groups.transform("max")) & (groups.transform("nunique") > 1)
    return table[[*ABLATION_KEYS, "value", "bold", "points", "seeds", "std", "reason"]]


def ablation_as_published(inits: Iterable[str]) -> pd.DataFrame:
    """Table 2 with its row of random points for each kind of them: the paper does not say which kind it had."""
    published = published_ablation()
    kinds = [init for init in inits if init.startswith("random")]
    random = published[published["init"] == "random"]
    return pd.concat([published[published["init"] != "random"], *(random.assign(init=kind) for kind in kinds)])


def to_csv(table: pd.DataFrame) -> str:
    """CSV text with n/a for numbers that are not there."""
    table = table.copy()
    for column in NUMBERS:
        if column in table:
            table[column] = ["n/a" if pd.isna(v) else f"{v:.6f}".rstrip("0").rstrip(".") for v in table[column]]
    if "bold" in table:
        table["bold"] = table["bold"].map({True: "true", False: "false"})
    return table.to_csv(index=False, lineterminator="\n")
