"""`report.html`: one file per experiment that opens from disk and needs no network."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from tdgbench.cells.record import Record, SkipRecord
from tdgbench.files import write_text
from tdgbench.present.html import STEPS, embedded, environment
from tdgbench.present.strip import place_name
from tdgbench.report.panels import line_colours
from tdgbench.report.run_facts import run_facts
from tdgbench.report.scene_section import scene_section
from tdgbench.scenes.registry import LABELS
from tdgbench.tables import methods
from tdgbench.tables.assumptions import doubts_of
from tdgbench.tables.build import Tables
from tdgbench.tables.cell_names import cell_title
from tdgbench.tables.columns import own_columns
from tdgbench.tables.grids import further_grid, reasons_for_na
from tdgbench.tables.long_table import method_label
from tdgbench.tables.measures import MAIN_COLUMNS, digits, known_measures, measure_of
from tdgbench.tables.palette import palette_notes
from tdgbench.tables.readings import changes_as_text
from tdgbench.tables.results import Cell, Results
from tdgbench.tables.verdicts import comparable, load_margins, verdicts_in_words
from tdgbench.text import named

NUMBER = re.compile(r"\d+(?:\.\d+)?")
MOST_BYTES = 2_000_000


def write_report(tables: Tables) -> Path:
    """Write the page of an experiment from its files on disk; return its path. What is unusable there is n/a."""
    with own_columns(tables.results.plan):
        content = _content(tables)
    for step in STEPS:
        pages = environment("tdgbench.report")
        pages.filters["embedded"] = partial(embedded, step=step)
        html = pages.get_template("report_page.html.j2").render(**content, step=step)
        if len(html.encode()) <= MOST_BYTES:
            break
    write_text(tables.results.report, html)
    return tables.results.report


def _content(tables: Tables) -> dict[str, Any]:
    """Return what the page's template shows, by name."""
    results, records, main = tables.results, tables.records, tables.main
    cells = in_order(results)
    colours = line_colours(method_label(cell.record, with_init=True) for cell in cells)  # the same in all scenes
    scenes: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        scenes.setdefault((cell.record.dataset, cell.record.scene, cell.record.split), []).append(cell)
    further = None if tables.is_ablation else further_grid(main)
    return {
        "name": results.folder.resolve().name,
        "findings": tables.findings,
        "facts": run_facts(results.plan, [cell.record for cell in cells]),
        "doubts": doubts_of(records),
        "table": tables.grid,
        "reasons": reasons_for_na(main, tables.grid.names),
        "further": further,
        "further_reasons": [] if further is None else reasons_for_na(main, further.names),
        "legend": legend(tables),
        "published": published_section(tables),
        "behind": [[*row.heads, title, cell.title] for row in tables.grid.rows
                for title, cell in zip(tables.grid.columns, row.cells, strict=True) if cell.note],
        "changes": None if tables.effects is None else changes_as_text(tables.effects),
        "changes_notes": [] if tables.effects is None else palette_notes(tables.effects),
        "scenes": [scene_section(place[0], place_name(place, scenes), group, colours)
                   for place, group in scenes.items()],
        "skips": skipped_work([cell.record for cell in cells]),
        "failures": [(cell_title(r), r.failure.phase, r.failure.error) for r in records if r.failure is not None],
        "problems": results.problems,
    }  # fmt: skip


def in_order(results: Results) -> list[Cell]:
    """Return the finished cells in the order of the tables: scenes as planned, methods by their `order`, seeds."""
    planned = {(scene.dataset, scene.scene): i for i, scene in enumerate(results.plan.scenes)}

    def position(cell: Cell) -> tuple[Any, ...]:
        column = method_label(cell.record, with_init=True)
        return planned.get(cell.dataset_and_scene, len(planned)), methods.rank(column), cell.record.seed

    return sorted(results.finished, key=position)


def skipped_work(records: Sequence[Record]) -> list[tuple[str, str, str, str]]:
    """Return each skip, the methods, what it saved and the reason: one row per method, with the range of numbers."""
    found: dict[tuple[str, str], list[SkipRecord]] = {}
    for record in records:
        for skip in record.skips:
            method = methods.label(method_label(record, with_init=True))
            found.setdefault((skip["name"], method), []).append(skip)
    rows: dict[tuple[str, str, str], list[str]] = {}
    for (name, method), skips in found.items():
        saved = [skip["saved"] if skip["taken"] else "nothing" for skip in skips]
        said = name, "; ".join(in_ranges(saved)), "; ".join(in_ranges(skip["reason"] for skip in skips))
        rows.setdefault(said, []).append(method)
    order = list(dict.fromkeys(name for name, _ in found))
    return sorted(
        ((name, named(them), saved, reason) for (name, saved, reason), them in rows.items()),
        key=lambda row: (order.index(row[0]), row[2] == "nothing"),
    )


def in_ranges(texts: Iterable[str]) -> list[str]:
    """Return texts that differ in numbers alone once, with the range of each number.

    >>> in_ranges(["12 of 40 views", "9 of 40 views", "nothing"])
    ['9 to 12 of 40 views', 'nothing']
    """
    found: dict[tuple[str, ...], list[list[str]]] = {}
    for text in texts:
        found.setdefault(tuple(NUMBER.split(text)), []).append(NUMBER.findall(text))
    lines = []
    for (first, *rest), numbers in found.items():
        ends = [sorted(set(column), key=float) for column in zip(*numbers, strict=True)]
        ranges = [" to ".join(dict.fromkeys((end[0], end[-1]))) for end in ends]
        lines.append(first + "".join(one + text for one, text in zip(ranges, rest, strict=True)))
    return lines


def legend(tables: Tables) -> list[dict[str, str]]:
    """Return meaning, range and requirements of the tables' measures, and what is fitted to a test view."""
    there = set(tables.main["metric"])
    return [
        {
            "title": described.title,
            "meaning": described.meaning,
            "range": " to ".join(f"{limit:g}".replace("inf", "∞") for limit in described.limits),
            "fits_to_test_view": getattr(described, "fits_to_test_view", "") or "nothing",
            "needs": getattr(described, "needs", ""),
        }
        for name, described in known_measures().items()
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
        [measure_of(str(metric)).title, f"{margins[str(metric)]:g}", verdicts_in_words(group)]
        for metric, group in known.groupby("metric", sort=False)
    ]
    return {"verdicts": verdicts, **_papers(tables.papers)}


def _papers(papers: pd.DataFrame) -> dict[str, Any]:
    """Return heads, rows of text and notes of the table of papers: per scene, each score as printed, and the spread."""
    metrics = [metric for metric in MAIN_COLUMNS if metric in set(papers["metric"])]
    rows = []
    for (method, dataset, scene), group in papers.groupby(["method", "dataset", "scene"], sort=False):
        printed = {row.metric: [row.values, f"{row.spread:.{digits(row.metric)}f}"] for row in group.itertuples()}
        cells = [text for metric in metrics for text in printed.get(metric, ["n/a", "n/a"])]
        rows.append([dataset, LABELS.get(str(scene), scene), methods.label(str(method)), *cells])
    titles = [title for metric in metrics for title in (measure_of(metric).title, "spread")]
    notes = [note for note in dict.fromkeys(papers["note"]) if note]
    return {"heads": ["data set", "scene", "method", *titles], "rows": rows, "notes": notes}
