"""The report's part on published numbers: the verdict on each, and the spread between papers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tdgbench.tables import methods
from tdgbench.tables.build import Tables
from tdgbench.tables.latex import LABELS
from tdgbench.tables.measures import PUBLISHED, as_text, digits, measure
from tdgbench.tables.verdicts import UNDECIDED, comparable, in_words, load_margins


def beside(published: Any, scene: str) -> tuple[str, str]:
    """A number's note (ours − published) and its tooltip; both empty without a published number or one of ours.

    published: a row of difference.csv, or None where nothing is published.
    """
    if published is None or np.isnan(published.difference):
        return "", ""
    metric = published.metric
    details = [f"published {as_text(metric, published.published, scene)}: {published.verdict}"]
    if published.verdict == UNDECIDED:
        details[0] += f", {published.why}; seeds needed: {published.seeds_needed}"
    if not np.isnan(published.low):
        interval = f"{published.low:.4g} to {published.high:.4g}"
        details.append(f"90 % interval of our mean: {interval}, margin {published.margin:g}")
    if published.papers > 1:
        ends = dict.fromkeys(as_text(metric, end, scene) for end in (published.others_low, published.others_high))
        details.append(f"other papers: {' to '.join(ends)}")
    return as_text(metric, published.difference, scene, f"+.{digits(metric, scene)}f"), "; ".join(details)


def published_section(tables: Tables) -> dict[str, Any] | None:
    """Verdicts by metric, and the table of papers; None where nothing is published for these scenes."""
    if tables.difference is None or tables.papers is None:
        return None
    margins = load_margins()
    judged = comparable(tables.difference)
    known = judged[judged["difference"].notna()]
    verdicts = [
        {"metric": measure(str(metric)).title, "margin": f"{margins[str(metric)]:g}", "counts": in_words(group)}
        for metric, group in known.groupby("metric", sort=False)
    ]
    return {"verdicts": verdicts, **_papers(tables.papers)}


def _papers(papers: pd.DataFrame) -> dict[str, Any]:
    """Heads, rows of text and notes of the table of papers: per scene, each score as printed, and the spread."""
    metrics = [metric for metric in PUBLISHED if metric in set(papers["metric"])]
    rows = []
    for (method, dataset, scene), group in papers.groupby(["method", "dataset", "scene"], sort=False):
        by_metric, cells = group.set_index("metric"), []
        for metric in metrics:
            row = by_metric.loc[metric] if metric in by_metric.index else None
            spread = "n/a" if row is None else f"{row['spread']:.{digits(metric)}f}"
            cells.append({"text": "n/a" if row is None else row["values"], "spread": spread})
        rows.append({"head": [dataset, LABELS.get(str(scene), scene), methods.label(str(method))], "cells": cells})
    notes = [note for note in dict.fromkeys(papers["note"]) if note]
    return {"metrics": [measure(metric).title for metric in metrics], "rows": rows, "notes": notes}
