"""What the page says beside published numbers: the verdict on each, and how far papers are apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tdgbench.tables.build import Tables
from tdgbench.tables.latex import LABELS
from tdgbench.tables.results import DECIMALS, METRICS, decimals
from tdgbench.tables.verdicts import UNDECIDED, in_words, load_margins


def beside(published: Any, scene: str) -> tuple[str, str]:
    """A published number's note (ours − published) and what hovering tells; empty without a number of ours.

    published: a row of difference.csv, or None where nothing is published.
    """
    if published is None or np.isnan(published.difference):
        return "", ""
    digits = decimals(published.metric, scene)
    said = [f"published {published.published:.{digits}f}: {published.verdict}"]
    if published.verdict == UNDECIDED:
        said[0] += f", {published.why}; seeds needed: {published.seeds_needed}"
    if not np.isnan(published.low):
        said.append(f"90 % of our mean: {published.low:.4g} to {published.high:.4g}, margin {published.margin:g}")
    if published.papers > 1:
        ends = dict.fromkeys(f"{end:.{digits}f}" for end in (published.others_low, published.others_high))
        said.append(f"other papers: {' to '.join(ends)}")
    return f"{published.difference:+.{digits}f}", "; ".join(said)


def section(tables: Tables, titles: dict[str, str]) -> dict[str, Any] | None:
    """Verdicts by metric, and the table of papers; None where nothing is published for these scenes.

    titles: of the metrics.
    """
    if tables.difference is None or tables.papers is None:
        return None
    margins = load_margins()
    known = tables.difference[tables.difference["difference"].notna() & tables.difference["metric"].isin(margins)]
    verdicts = [
        {"metric": titles[str(metric)], "margin": f"{margins[str(metric)]:g}", "said": in_words(group)}
        for metric, group in known.groupby("metric", sort=False)
    ]
    return {"verdicts": verdicts, **_papers(tables.papers, titles)}


def _papers(papers: pd.DataFrame, titles: dict[str, str]) -> dict[str, Any]:
    """Heads, rows of text and notes of the table of papers: per scene, each score as printed, and the spread."""
    metrics = [metric for metric in METRICS if metric in set(papers["metric"])]
    rows = []
    for (method, dataset, scene), group in papers.groupby(["method", "dataset", "scene"], sort=False):
        by_metric, cells = group.set_index("metric"), []
        for metric in metrics:
            row = by_metric.loc[metric] if metric in by_metric.index else None
            spread = "n/a" if row is None else f"{row['spread']:.{DECIMALS[metric]}f}"
            cells.append({"text": "n/a" if row is None else row["values"], "spread": spread})
        rows.append({"head": [dataset, LABELS.get(str(scene), scene), method], "cells": cells})
    notes = [note for note in dict.fromkeys(papers["note"]) if note]
    return {"metrics": [titles[metric] for metric in metrics], "rows": rows, "notes": notes}
