"""What the report says beside its grid of scores: their meaning, depth priors, verdicts, the spread between papers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.tables import methods
from tdgbench.tables.build import Tables
from tdgbench.tables.latex import LABELS
from tdgbench.tables.measures import MEASURES, PUBLISHED, digits
from tdgbench.tables.verdicts import comparable, load_margins, verdicts_in_words

SOURCES = {  # of depth priors, in words
    "points": "the sparse points, which come from RGB images: no evidence for a method of thermal images alone",
    "truth": "true depth, with the errors of a monocular network",
}


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
