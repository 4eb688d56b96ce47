"""The report's tables: scores beside published numbers, what they mean, verdicts, and the spread between papers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.tables import methods
from tdgbench.tables.build import ABLATION_KEYS, Tables
from tdgbench.tables.latex import LABELS
from tdgbench.tables.long_table import initial_points, protocol_notes
from tdgbench.tables.measures import ABLATION, COLUMNS, EXTRA, MEASURES, OVERALL, PUBLISHED, as_text, digits
from tdgbench.tables.palette import palette_notes, with_mark
from tdgbench.tables.verdicts import UNDECIDED, comparable, load_margins, verdicts_in_words

SOURCES = {  # of depth priors, in words
    "points": "the sparse points, which come from RGB images: no evidence for a method of thermal images alone",
    "truth": "true depth, with the errors of a monocular network",
}


def main_scores(tables: Tables) -> dict[str, Any]:
    """Return heads, measures, notes, rows of cells: text, value to sort by, bold, difference from print, verdict."""
    if tables.kind == "ablation":
        return _ablation(tables)
    found = _by_scene(tables, list(COLUMNS), _published(tables, ["method", "dataset", "scene", "metric"]))
    return {**found, "notes": [*protocol_notes(tables.main), *palette_notes(tables.main)]}


def further_scores(tables: Tables) -> dict[str, Any] | None:
    """Return the other measures that a cell of the main table has, in the same form; None without any."""
    if tables.kind == "ablation":
        return None
    known = set(tables.main.loc[tables.main["value"].notna(), "metric"])
    metrics = [metric for metric in EXTRA if metric in known]
    return {**_by_scene(tables, metrics, {}), "notes": palette_notes(tables.main)} if metrics else None


def depth_priors(records: Sequence[Record]) -> list[str]:
    """Say what the finished cells took as depth priors: method, estimator, and what its maps are made from.

    >>> prior = {"estimator": "marigold", "model": "prs-eth/marigold-depth-v1-1", "made_from": "thermal images"}
    >>> depth_priors([Record("mine", "", "a", "", 0, "", "", prior=prior)])
    ['mine: marigold (prs-eth/marigold-depth-v1-1), made from thermal images']
    """
    found = []
    for record in records:
        if record.prior is None or record.failure is not None:
            continue
        model, source = record.prior.get("model"), record.prior.get("made_from")
        name = f"{record.prior.get('estimator', 'unknown')}{f' ({model})' if model else ''}"
        made = f", made from {SOURCES.get(str(source), source)}" if source else ""
        found.append(f"{methods.label(record.method)}: {name}{made}")
    return list(dict.fromkeys(found))


def legend(tables: Tables) -> list[dict[str, str]]:
    """Return meaning, range and requirements of the tables' measures, and what is fitted to a test view."""
    there = set(tables.main["metric"])
    return [
        {
            "title": described.title,
            "meaning": described.meaning,
            "range": " to ".join("∞" if math.isinf(limit) else f"{limit:g}" for limit in described.limits),
            "fits_to_test_view": getattr(described, "fits_to_test_view", "") or "nothing",
            "needs": getattr(described, "needs", ""),
        }
        for name, described in MEASURES.items()
        if name in there
    ]


def published_section(tables: Tables) -> dict[str, Any] | None:
    """Return verdicts by metric, and the table of papers; None where nothing is published for these scenes."""
    if tables.difference is None or tables.papers is None:
        return None
    margins = load_margins()
    judged = comparable(tables.difference)
    known = judged[judged["difference"].notna()]
    verdicts = [
        [MEASURES[str(metric)].title, f"{margins[str(metric)]:g}", verdicts_in_words(group)]
        for metric, group in known.groupby("metric", sort=False)
    ]
    return {"verdicts": verdicts, **_papers(tables.papers)}


def _papers(papers: pd.DataFrame) -> dict[str, Any]:
    """Return heads, rows of text and notes of the table of papers: per scene, each score as printed, and the spread."""
    metrics = [metric for metric in PUBLISHED if metric in set(papers["metric"])]
    rows = []
    for (method, dataset, scene), group in papers.groupby(["method", "dataset", "scene"], sort=False):
        printed = {row.metric: [row.values, f"{row.spread:.{digits(row.metric)}f}"] for row in group.itertuples()}
        cells = [text for metric in metrics for text in printed.get(metric, ["n/a", "n/a"])]
        rows.append([dataset, LABELS.get(str(scene), scene), methods.label(str(method)), *cells])
    titles = [title for metric in metrics for title in (MEASURES[metric].title, "spread")]
    notes = [note for note in dict.fromkeys(papers["note"]) if note]
    return {"heads": ["data set", "scene", "method", *titles], "rows": rows, "notes": notes}


def _by_scene(tables: Tables, metrics: list[str], published: dict[tuple[Any, ...], Any]) -> dict[str, Any]:
    """Return the rows of the main table in its order, methods of a scene together."""
    values = {(r.method, r.dataset, r.scene, r.metric): r for r in tables.main.itertuples()}
    rows = []
    for (dataset, scene), group in tables.main.groupby(["dataset", "scene"], sort=False):
        for method, of_method in group.groupby("method", sort=False):
            keys = [(method, dataset, scene, metric) for metric in metrics]
            cells = [_number(values[key], published.get(key)) for key in keys]
            head = [dataset, with_mark(str(scene), of_method), methods.label(str(method))]
            key = (dataset, scene, method)
            rows.append({"head": head, "key": key, "cells": cells})
    return {"heads": ["data set", "scene", "method"], "metrics": [MEASURES[m].title for m in metrics], "rows": rows}


def _ablation(tables: Tables) -> dict[str, Any]:
    published, rows = _published(tables, ABLATION_KEYS), []
    for (method, init), group in tables.main.assign(scene=OVERALL).groupby(["method", "init"], sort=False):
        by_metric = {row.metric: row for row in group.itertuples()}
        cells = [_number(by_metric[m], published.get((method, init, m))) for m in ABLATION]
        rows.append({"head": [with_mark(methods.label(str(method)), group), init], "cells": cells})
    titles = [MEASURES[m].title for m in ABLATION]
    notes = [*initial_points(tables.main), *palette_notes(tables.main)]
    return {"heads": ["method", "initial points"], "metrics": titles, "rows": rows, "notes": notes}


def _published(tables: Tables, keys: list[str]) -> dict[tuple[Any, ...], Any]:
    """Return the rows of difference.csv by their keys."""
    if tables.difference is None:
        return {}
    return {tuple(getattr(r, k) for k in keys): r for r in tables.difference.itertuples()}


def _number(row: Any, published: Any) -> dict[str, Any]:
    if np.isnan(row.value):
        return {"text": "n/a", "sort": "", "bold": False, "title": row.reason, "note": "", "verdict": ""}
    text = as_text(row.metric, row.value, row.scene)
    std = getattr(row, "std", np.nan)
    if not np.isnan(std):
        text += f" ± {as_text(row.metric, std, row.scene)}"
    ends = [getattr(row, end, np.nan) for end in ("ci95_low", "ci95_high")]
    span = " to ".join(as_text(row.metric, end, form=".4g") for end in ends if not np.isnan(end))
    interval = f"95 % interval over seeds and views: {span}" if span else ""
    note, details = difference_note(published, row.scene)
    title = "; ".join(part for part in (details, interval) if part)
    verdict = published.verdict if note else ""
    return {"text": text, "sort": row.value, "bold": bool(row.bold), "title": title, "note": note, "verdict": verdict}


def difference_note(published: Any, scene: str) -> tuple[str, str]:
    """Return a number's note (ours − published) and its tooltip; both empty without a published number or one of ours.

    published: a row of difference.csv, or None where nothing is published.
    """
    if published is None or np.isnan(published.difference):
        return "", ""
    metric = published.metric
    details = [f"published {as_text(metric, published.published, scene)}: {published.verdict}"]
    if published.verdict == UNDECIDED:
        details[0] += f", {published.undecided_because}; seeds needed: {published.seeds_needed}"
    if not np.isnan(published.ci90_low):
        interval = f"{published.ci90_low:.4g} to {published.ci90_high:.4g}"
        details.append(f"90 % interval of our mean: {interval}, margin {published.margin:g}")
    if published.papers > 1:
        ends = dict.fromkeys(as_text(metric, end, scene) for end in (published.others_low, published.others_high))
        details.append(f"other papers: {' to '.join(ends)}")
    return as_text(metric, published.difference, scene, f"+.{digits(metric, scene)}f"), "; ".join(details)
