"""Grids of the main table and of the ablation: our numbers, with published ones and verdicts beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from tdgbench.present.grid import Grid, GridCell, GridRow
from tdgbench.scenes.registry import DATASETS
from tdgbench.scoring.metric import FAILED
from tdgbench.tables import methods
from tdgbench.tables.comparisons import FEWEST_SEEDS, bold_note
from tdgbench.tables.long_table import NO_RECORD, RANGE, initial_points, protocol_notes, split_notes
from tdgbench.tables.measures import (
    ABLATION,
    AVERAGE,
    COLUMNS,
    GAUSSIANS,
    HOURS,
    MAIN_COLUMNS,
    OVERALL,
    as_text,
    digits,
    further,
    measure_of,
    own_metrics,
)
from tdgbench.tables.palette import is_marked, palette_notes, with_mark
from tdgbench.tables.verdicts import NEVER, UNDECIDED
from tdgbench.text import named

NO_BOLD = f"no bold type: it needs {FEWEST_SEEDS} seeds of each method"
SPREAD = "± is the standard deviation over seeds"
TIMES = "times: training of all models of a method, an RGB model too, without making depth priors"
GAUSSIANS_NOTE = "Gaussians: of all models of a method, an RGB model too"
SCENE_KEYS = ["dataset", "scene", "method"]
ERROR, RANGE_TITLE = "mae_degC", "range, °C"
ABLATION_KEYS = ["method", "init", "metric"]


def main_grid(
    main: pd.DataFrame, difference: pd.DataFrame | None, metrics: Sequence[str] = (), notes: Sequence[str] = ()
) -> Grid:
    """Return the rows of a main table in its order, methods of a scene together; their `place` is of SCENE_KEYS.

    metrics: by default COLUMNS; where there are °C, with the error in °C and the range, on which PSNR depends. notes:
    on unlike trainings. Averages of one scene are left out.
    """
    published = _by_keys(difference, [*SCENE_KEYS, "metric"])
    metrics = metrics or _usual_columns(main)
    scenes = main[~main["scene"].isin((AVERAGE, OVERALL))].groupby("dataset")["scene"].nunique()
    rows = []
    for (dataset, scene), of_scene in main.groupby(["dataset", "scene"], sort=False):
        if scene == AVERAGE and scenes[dataset] == 1:
            continue
        for method, group in of_scene.groupby("method", sort=False):
            place = (str(dataset), str(scene), str(method))
            heads = (place[0], with_mark(place[1], group), methods.label(place[2]))
            cells = _cells(group, place, metrics, published)
            rows.append(GridRow(heads, cells, place, str(group["group"].iloc[0]), is_marked(group)))
    times = [TIMES] * bool(HOURS.name in metrics and main["value"][main["metric"] == HOURS.name].notna().any())
    counts = [GAUSSIANS_NOTE] * (GAUSSIANS.name in metrics)
    lines = [*split_notes(main), *protocol_notes(main), *_number_notes(main), *times, *counts, *palette_notes(main)]
    titles = [RANGE_TITLE if metric == RANGE else measure_of(metric).title for metric in metrics]
    return Grid(["data set", "scene", "method"], titles, rows, [*lines, *notes], metrics)


def _usual_columns(main: pd.DataFrame) -> tuple[str, ...]:
    in_degC = (main["value"].notna() & (main["metric"] == ERROR)).any()
    beside = {MAIN_COLUMNS[0]: (ERROR, RANGE)} if in_degC else {}
    return tuple(one for name in COLUMNS for one in (name, *beside.get(name, ())))


def _number_notes(main: pd.DataFrame) -> list[str]:
    known = main[main["value"].notna()]
    several = len(known[["method", "init"] if "init" in main else ["method"]].drop_duplicates()) > 1
    bold = [bold_note()] if main["bold"].any() else [NO_BOLD] * bool(several and known["seeds"].min() < FEWEST_SEEDS)
    return [*bold, *[SPREAD] * bool(main["std"].notna().any())]


def further_grid(main: pd.DataFrame) -> Grid | None:
    """Return the other measures that a cell of a main table has, in the same form; None without any.

    The user's metrics that failed are among them, as n/a.
    """
    known = {*main.loc[main["value"].notna(), "metric"], *failed_metrics(main)}
    metrics = [metric for metric in further() if metric in known]
    if not metrics:
        return None
    spread = [SPREAD] * bool(main.loc[main["metric"].isin(metrics), "std"].notna().any())
    return replace(main_grid(main, None, metrics), notes=[*spread, *palette_notes(main)])


def failed_metrics(main: pd.DataFrame) -> list[str]:
    """Return the user's metrics that raised an error in some row."""
    failed = {*main.loc[main["reason"].str.contains(rf"^(?:in \d+ of \d+ seeds )?{FAILED}"), "metric"]}
    return [metric for metric in own_metrics() if metric in failed]


def ablation_grid(main: pd.DataFrame, difference: pd.DataFrame | None, notes: Sequence[str] = ()) -> Grid:
    """Return the rows of an ablation by method and initial points, their `place`. notes: on unlike trainings."""
    published, rows = _by_keys(difference, ABLATION_KEYS), []
    for (method, init), group in main.assign(scene=OVERALL).groupby(["method", "init"], sort=False):
        place = (str(method), str(init))
        heads = (with_mark(methods.label(place[0]), group), place[1])
        rows.append(GridRow(heads, _cells(group, place, ABLATION, published), place, "", is_marked(group)))
    lines = [*initial_points(main), *_number_notes(main), *palette_notes(main), *notes]
    return Grid(["method", "initial points"], [measure_of(metric).title for metric in ABLATION], rows, lines, ABLATION)


def reasons_for_na(main: pd.DataFrame, metrics: Sequence[str]) -> list[str]:
    """Return why numbers of a main table or an ablation are n/a: measures, the rows that lack them, and the reason."""
    shown = main[main["metric"].isin(metrics)]
    missing, place = shown[shown["value"].isna()], "scene" if "scene" in main else "init"
    rows_of = shown.groupby(["method", "metric"]).size()
    found: dict[tuple[str, str], list[str]] = {}
    for (metric, reason), group in missing.groupby(["metric", "reason"], sort=False):
        who: dict[str, list[str]] = {}  # methods by the places where they lack it
        for method, rows in group.groupby("method", sort=False):
            where = "" if len(rows) == rows_of[method, metric] else f" on {named(rows[place])}"
            who.setdefault(where, []).append(methods.label(str(method)))
        listed = "; ".join(named(them) + where for where, them in who.items())
        names = "all rows" if len(group) == rows_of[:, metric].sum() else listed
        found.setdefault((names, str(reason)), []).append(measure_of(str(metric)).title.rstrip(" ↑↓"))
    lines = [f"n/a: {'; '.join(titles)} ({names}): {reason}" for (names, reason), titles in found.items()]
    absent = set(missing.loc[missing["reason"] == NO_RECORD, "dataset"]) if "dataset" in missing else set()
    gets = [f"`tdgbench data get {key} data`" for key, title in DATASETS.items() if title in absent]
    return [*lines, *([f"scenes that are not on disk: {' and '.join(gets)} download them"] if gets else [])]


def _by_keys(difference: pd.DataFrame | None, keys: list[str]) -> dict[tuple[str, ...], Any]:
    """Return the rows of difference.csv by their keys."""
    if difference is None:
        return {}
    return dict(zip(difference[keys].itertuples(index=False, name=None), difference.itertuples(), strict=True))


def _cells(
    group: pd.DataFrame, place: tuple[str, ...], metrics: Sequence[str], published: dict[tuple[str, ...], Any]
) -> tuple[GridCell, ...]:
    """Return the numbers of one row of a grid. group: its rows of main.csv. published: `_by_keys`."""
    by_metric = {row.metric: row for row in group.itertuples()}
    span = group[RANGE].iloc[0] if RANGE in metrics else ""
    of_scene = GridCell(span or "n/a", span or "n/a", sort=span)
    return tuple(
        of_scene if metric == RANGE else _cell(by_metric[metric], published.get((*place, metric))) for metric in metrics
    )


def _cell(row: Any, published: Any) -> GridCell:
    """Return a number. row: of main.csv. published: row of difference.csv, or None where nothing is published."""
    beside = published_beside(published, row.scene)
    if np.isnan(row.value):
        return GridCell(title=row.reason, published=beside)
    mean = text = as_text(row.metric, row.value, row.scene)
    if not np.isnan(row.std):
        text += f" ± {as_text(row.metric, row.std, row.scene)}"
    ends = [getattr(row, end, np.nan) for end in ("ci95_low", "ci95_high") if row.metric != HOURS.name]
    has_width = len(ends) == 2 and ends[0] < ends[1]  # none of what is no mean over views
    span = " to ".join(as_text(row.metric, end, row.scene) for end in ends) if has_width else ""
    note, details = difference_note(published, row.scene)
    verdict = published.verdict if note else ""
    return GridCell(text, mean, row.value, row.value, bool(row.bold), details, note, verdict, beside, row.std, span)


def difference_note(published: Any, scene: str) -> tuple[str, str]:
    """Return a number's note (ours − published) and its tooltip; both empty without a published number or one of ours.

    published: a row of difference.csv, or None where nothing is published.
    """
    if published is None or np.isnan(published.difference):
        return "", ""
    metric = published.metric
    word = f"not judged: {published.undecided_because}" if published.verdict == NEVER else published.verdict
    details = [f"published {as_text(metric, published.published, scene)}: {word}"]
    if published.verdict == UNDECIDED:
        details[0] += f", {published.undecided_because}; seeds needed: {published.seeds_needed}"
    if not np.isnan(published.ci90_low):
        interval = f"{published.ci90_low:.4g} to {published.ci90_high:.4g}"
        details.append(f"90 % interval of our mean: {interval}, margin {published.margin:g}")
    if published.papers > 1:
        ends = dict.fromkeys(as_text(metric, end, scene) for end in (published.others_low, published.others_high))
        perhaps = " (perhaps of another method)" if published.others_doubt else ""
        details.append(f"other papers{perhaps}: {' to '.join(ends)}")
    return as_text(metric, published.difference, scene, f"+.{digits(metric, scene)}f"), "; ".join(details)


def published_beside(published: Any, scene: str) -> str:
    """Return the published number beside one of ours, with its verdict; empty without."""
    if published is None or np.isnan(published.published):
        return ""
    text = f"published {as_text(published.metric, published.published, scene)}"
    is_judged = published.metric != HOURS.name and published.verdict != NEVER and not np.isnan(published.difference)
    return f"{text}, {published.verdict}" if is_judged else text
