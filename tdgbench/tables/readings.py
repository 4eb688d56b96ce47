"""As written and as released at equal iterations: scores by method and length, and the change of each difference.

Effects are paired: cells that differ in one thing share initial points, seed and setup (`likeness.setups`). Their
interval is Student's over seeds, of the mean over scenes; each scene has its row as well.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.scoring import METRICS
from tdgbench.tables import methods
from tdgbench.tables.likeness import setups, was_disturbed
from tdgbench.tables.long_table import method_label, metric_value, planned_iterations
from tdgbench.tables.measures import (
    AVERAGE,
    GAUSSIANS,
    HOURS,
    MAIN_COLUMNS,
    MAIN_SCORES,
    MEMORY,
    OF_RECORDS,
    OVERALL,
    PARAMETERS,
    digits,
    measure_of,
)
from tdgbench.tables.palette import with_mark
from tdgbench.tables.published import is_over_papers_scenes, published_main
from tdgbench.tables.statistics import mean_interval, with_interval

COMPARED = (*MAIN_COLUMNS, GAUSSIANS.name)  # columns of the printed tables of changes
SHOWN = (*MAIN_COLUMNS, "depth_inconsistency", GAUSSIANS.name, PARAMETERS.name, MEMORY.name)  # of averages
_OMITTED = {name for name in METRICS if METRICS[name].unit == "°C"}  # scale with a scene's temperature range
SCORES = (
    *MAIN_SCORES,
    *sorted(name for name in set(METRICS) - set(MAIN_COLUMNS) - _OMITTED if not METRICS[name].images),
)
PLACE = ["dataset", "scene", "init", "split", "seed", "setup"]
CHANGES = ["init", "split", "dataset", "scene", "metric", "kind", "change", "ci95_low", "ci95_high", "seeds", "scenes"]


class Effect(NamedTuple):
    """A change of one thing: cells of method `after` against cells of method `before` of the same length."""

    name: str
    before: str
    after: str


EFFECTS = (
    Effect("depth, as written", "3dgs_smooth", "tdg"),
    Effect("smoothness, eq. 6", "3dgs", "3dgs_smooth"),
    Effect("smoothness, as released", "3dgs", "tdg_released"),
    Effect("released reading for the written one", "tdg", "tdg_released"),
    Effect("RGB model left out", "msmg", "msmg_thermal"),
    Effect("RGB model and MSMG's weights left out", "msmg", "tdg_released"),
    Effect("all: TDg as written for MSMG", "msmg", "tdg"),
)


def compared_methods() -> list[Effect]:
    """Return EFFECTS, and every other pair that a method's `compared_with` names."""
    known = {(effect.after, effect.before) for effect in EFFECTS}
    more = [pair for pair in methods.pairs() if pair not in known]
    return [*EFFECTS, *(Effect(f"{methods.label(a)} for {methods.label(b)}", b, a) for a, b in more)]


def reading_label(record: Record) -> str:
    """Return the method with what a sweep names but iterations and split, which have columns.

    >>> reading_label(Record("tdg", "", "a", "colmap", 0, "", "budget.iterations=9,prior=files"))
    'tdg [prior=files]'
    """
    named = (one for one in record.variant.split(",") if not one.startswith(("budget.iterations=", "data.split=")))
    return method_label(replace(record, variant=",".join(named)), with_init=False)


def reading_cells(records: Iterable[Record]) -> pd.DataFrame:
    """Return one row per finished cell and known number: method, iterations, PLACE, metric, value.

    setup: what has to agree between cells that compare in this number. Times of a busy machine are left out.
    """
    records, rows = [record for record in records if record.failure is None], []
    names = (*SCORES, *(described.name for described in OF_RECORDS))
    for record, *alike in zip(records, setups(records), setups(records, timed=True), strict=True):
        place = [record.dataset, record.scene, record.init, record.split, record.seed]
        values = {name: metric_value(record, name)[0] for name in names}
        rows += [
            [reading_label(record), planned_iterations(record), *place, alike[name == HOURS.name], name, value]
            for name, value in values.items()
            if not np.isnan(value) and not (name == HOURS.name and was_disturbed(record))
        ]
    return pd.DataFrame(rows, columns=["method", "iterations", *PLACE, "metric", "value"])


def readings(cells: pd.DataFrame) -> pd.DataFrame:
    """Return method, iterations, init, split, dataset, scene, metric, value, std, seeds, published: means over seeds.

    Averages are over the scenes that every method and length has; a seed that lacks one of them has no average. A mean
    over seeds of unlike trainings is NaN, and in no average.
    published: the paper's number from COLMAP's points, beside its baseline at the most iterations and its method at the
    fewest; of an average, only if it is over the paper's scenes.
    """
    keys = ["method", "iterations", "init", "split", "metric"]
    if cells.empty:
        return pd.DataFrame(columns=[*keys[:4], "dataset", "scene", "metric", "value", "std", "seeds", "published"])
    setups_of = cells.groupby([*keys, "dataset", "scene"], sort=False)["setup"].transform("nunique")
    cells = cells.assign(value=cells["value"].where(setups_of == 1))
    by_seed = [cells]
    shared = _shared_scenes(cells)
    for names, scene in ((["dataset"], AVERAGE), ([], OVERALL)):
        common = cells[[key in shared for key in zip(cells["dataset"], cells["scene"], strict=True)]]
        if scene == OVERALL and common["dataset"].nunique() < 2:
            continue
        groups = common.groupby([*keys, "seed", *names], sort=False)["value"]
        wanted = common.drop_duplicates(["dataset", "scene"]).groupby(names)["scene"].count() if names else len(shared)
        means = groups.agg(["mean", "count"]).reset_index()
        full = means["dataset"].map(wanted) if names else wanted
        means = means[means["count"] == full].rename(columns={"mean": "value"})
        by_seed.append(means.assign(scene=scene, dataset=means["dataset"] if names else ""))
    table = pd.concat(by_seed, ignore_index=True)
    grouped = table.groupby([*keys[:4], "dataset", "scene", "metric"], sort=False)
    scores = grouped.agg(value=("value", "mean"), std=("value", "std"), seeds=("seed", "nunique")).reset_index()
    return _with_published(scores, shared)


def widest_average(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the widest average; with one scene alone, all rows."""
    for name in (OVERALL, AVERAGE):
        if (rows["scene"] == name).any():
            return rows[rows["scene"] == name]
    return rows


def with_setup(rows: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return the rows with initial points and split added to a column's text, where the table has several of them."""
    varied = [name for name in ("init", "split") if rows[name].nunique() > 1]
    if not varied:
        return rows
    setup = rows[varied].agg(", ".join, axis=1)
    return rows.assign(**{column: rows[column].astype(str) + " (" + setup + ")"})


def _shared_scenes(cells: pd.DataFrame) -> set[tuple[str, str]]:
    """Return (dataset, scene) that every method and length has."""
    scores = cells[cells["metric"] == "psnr"]
    places = [set(zip(g["dataset"], g["scene"], strict=True)) for _, g in scores.groupby(["method", "iterations"])]
    return set.intersection(*places) if places else set()


def _with_published(scores: pd.DataFrame, shared: set[tuple[str, str]]) -> pd.DataFrame:
    """Return `readings` with the column `published`. shared: (dataset, scene) that averages are over."""
    printed = published_main()[["method", "dataset", "scene", "metric", "value"]].rename(columns={"value": "published"})
    length = {}
    pair = methods.paper_pair()
    for method, choose in ((pair.baseline, max), (pair.method, min)):
        of_method = scores.loc[scores["method"] == method, "iterations"]
        if len(of_method):
            length[method] = choose(of_method)
    printed["iterations"] = printed["method"].map(length)
    table = scores.merge(printed, on=["method", "iterations", "dataset", "scene", "metric"], how="left")
    is_average = table["scene"].isin((AVERAGE, OVERALL))
    is_papers = {name: is_over_papers_scenes(shared, name) for name in table["dataset"].unique()}
    unlike = (table["init"] != "colmap") | (is_average & ~table["dataset"].map(is_papers).astype(bool))
    return table.assign(published=table["published"].mask(unlike))


def effects(cells: pd.DataFrame) -> pd.DataFrame:
    """Return effect, iterations, init, split, dataset, scene, metric, kind, change, ci95_low, ci95_high, seeds, scenes.

    kind: `difference` (after − before), or `ratio` (after / before) for times and Gaussians. ci95: the interval over
    seeds, NaN for one seed. The rows are the compared methods at each length; fewer iterations, method
    by method; and the paper's method at the fewest iterations against its baseline at the most, as published.
    """
    lengths = sorted(cells["iterations"].unique())
    named = sorted({space + rest for _, space, rest in (column.partition(" ") for column in cells["method"].unique())})
    pairs = [(e.name + rest, (e.before + rest, n), (e.after + rest, n))
             for n in lengths for e in compared_methods() for rest in named]  # fmt: skip
    if len(lengths) > 1:
        few, many = lengths[0], lengths[-1]
        pairs += [(f"fewer iterations: {m}", (m, many), (m, few)) for m in cells["method"].unique()]
        new, old = methods.paper_pair()
        name = f"as published: {methods.label(new)} at the fewest for {methods.label(old)} at the most"
        pairs += [(name + rest, (old + rest, many), (new + rest, few)) for rest in named]
    parts = []
    for name, before, after in pairs:
        a, b = (cells[(cells["method"] == m) & (cells["iterations"] == n)] for m, n in (before, after))
        both = a.merge(b, on=[*PLACE, "metric"], suffixes=("_before", "_after"))
        if not both.empty:
            lengths_used = str(after[1]) if before[1] == after[1] else f"{before[1]} → {after[1]}"
            parts.append(_changes(both).assign(effect=name, iterations=lengths_used))
    columns = ["effect", "iterations", *CHANGES]
    return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)


def _changes(both: pd.DataFrame) -> pd.DataFrame:
    """Return changes by scene, and over all scenes that every seed has; none where seeds of a scene are unlike."""
    ratio = both["metric"].map(lambda name: measure_of(name).ratio)
    before, after = both["value_before"], both["value_after"]
    logs = np.log((after / before).where(ratio, 1.0))
    both = both.assign(change=(after - before).where(~ratio, logs))
    rows = []
    setups_of = both[both["metric"] == MAIN_SCORES[0]].groupby(PLACE[:4])["setup"].nunique()  # not of times: machines
    both = both[~both.set_index(PLACE[:4]).index.isin(setups_of.index[setups_of > 1])]
    for (init, split, metric), group in both.groupby(["init", "split", "metric"], sort=False):
        wide = group.pivot_table(index="seed", columns=["dataset", "scene"], values="change").dropna(axis=1)
        places = [(dataset, scene, wide[[(dataset, scene)]]) for dataset, scene in wide.columns]
        if wide.shape[1] > 1:
            datasets = wide.columns.get_level_values(0).unique()
            places.append((datasets[0] if len(datasets) == 1 else "", AVERAGE if len(datasets) == 1 else OVERALL, wide))
        for dataset, scene, values in places:
            mean, low, high = mean_interval(values.mean(axis=1).to_numpy())
            kind = "ratio" if measure_of(str(metric)).ratio else "difference"
            numbers = np.exp([mean, low, high]) if kind == "ratio" else (mean, low, high)
            rows.append([init, split, dataset, scene, metric, kind, *numbers, len(values), values.shape[1]])
    return pd.DataFrame(rows, columns=CHANGES)


def changes_as_text(changes: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Return heads and rows for a reader: each change of the widest average with its interval. changes: `effects`."""
    heads = ["change", "iterations", "scene", *(measure_of(name).change for name in COMPARED)]
    rows = []
    shown = with_setup(widest_average(changes), "effect")
    for place, group in shown.groupby(["effect", "iterations", "scene"], sort=False):
        by_metric = {row.metric: row for row in group.itertuples()}
        named = [*map(str, place[:2]), with_mark(str(place[2]), group)]
        rows.append([*named, *(change_as_text(by_metric.get(m)) for m in COMPARED)])
    return heads, rows


def change_as_text(row: Any) -> str:
    """Return a change with its interval, where it has one. row: of `effects`, or None."""
    if row is None:
        return "n/a"
    form = ".2f" if row.kind == "ratio" else f"+.{digits(row.metric)}f"
    return with_interval(format(row.change, form), row.ci95_low, row.ci95_high, form)
