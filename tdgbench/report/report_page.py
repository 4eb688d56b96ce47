"""`report.html`: one file per experiment that opens from disk and needs no network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from tdgbench.cells.record import READ_PHASE, Record, SkipRecord
from tdgbench.files import write_text
from tdgbench.present.html import environment
from tdgbench.present.strip import place_name
from tdgbench.report.scene_section import scene_section
from tdgbench.tables import methods
from tdgbench.tables.assumptions import doubts_of
from tdgbench.tables.build import Tables
from tdgbench.tables.grids import further_grid
from tdgbench.tables.latex import LABELS
from tdgbench.tables.measures import MEASURES, PUBLISHED, digits
from tdgbench.tables.palette import palette_notes
from tdgbench.tables.readings import changes_as_text
from tdgbench.tables.results import Cell
from tdgbench.tables.verdicts import comparable, load_margins, verdicts_in_words

FILE = "report.html"
SOURCES = {  # of depth priors, in words
    "points": "the sparse points, which come from RGB images: no evidence for a method of thermal images alone",
    "truth": "true depth, with the errors of a monocular network",
}


def write_report(tables: Tables) -> Path:
    """Write the page of an experiment from its files on disk; return its path. What is unusable there is n/a."""
    results, records = tables.results, tables.records
    scenes: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in results.finished:
        scenes.setdefault((cell.record.dataset, cell.record.scene, cell.record.split), []).append(cell)
    html = environment("tdgbench.report").get_template("report_page.html.j2").render(
        name=results.folder.resolve().name,
        findings=tables.findings,
        doubts=doubts_of(records),
        table=tables.grid,
        further=None if tables.is_ablation else further_grid(tables.main),
        priors=depth_priors(records),
        legend=legend(tables),
        published=published_section(tables),
        changes=None if tables.effects is None else changes_as_text(tables.effects),
        changes_notes=[] if tables.effects is None else palette_notes(tables.effects),
        scenes=[scene_section(place[0], place_name(place, scenes), group) for place, group in scenes.items()],
        skips=[{"title": cell.record.title, "skips": map(_skipped, cell.record.skips)} for cell in results.finished],
        failures=[(r.title, r.failure.phase, r.failure.error) for r in records if r.failure is not None],
        problems=results.problems,
        environments=environments(records),
    )  # fmt: skip
    path = results.folder / FILE
    write_text(path, html)
    return path


def _skipped(skip: SkipRecord) -> tuple[str, str, str]:
    return skip["name"], skip["saved"] if skip["taken"] else "nothing", skip["reason"]


def environments(records: list[Record]) -> list[list[tuple[str, str]]]:
    """Return the distinct machines and versions that the cells ran on; unreadable records say nothing of them."""
    groups = []
    for record in records:
        if record.failure is not None and record.failure.phase == READ_PHASE:
            continue
        e = record.environment
        packages = ", ".join(f"{name} {version}" for name, version in _entries(e, "packages") if version)
        git = dict(_entries(e, "git"))
        commit = str(git.get("commit", "not from a checkout")) + (" with changes" if git.get("dirty") else "")
        rows = [
            ("processor", f"{e.get('cpu')}, {e.get('cores')} cores, {e.get('threads')} threads"),
            ("GPU", ", ".join(f"{name} {value}" for name, value in _entries(e, "gpu")) or "none"),
            ("platform", f"{e.get('platform')}, Python {e.get('python')}"),
            ("packages", packages),
            ("commit", commit),
            ("protocol", f"{record.protocol or 'n/a'}, metrics as {record.convention}"),
        ]
        if rows not in groups:
            groups.append(rows)
    return groups


def _entries(environment: dict[str, Any], name: str) -> list[tuple[str, Any]]:
    """Return the entries of a part of an environment; none where it is null or no object."""
    part = environment.get(name)
    return list(part.items()) if isinstance(part, dict) else []


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
