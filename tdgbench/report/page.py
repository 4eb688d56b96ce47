"""`report.html`: one file per experiment that opens from disk and needs no network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tdgbench.cells.record import READ_PHASE, Record, SkipRecord
from tdgbench.files import write_text
from tdgbench.present.pages import environment
from tdgbench.present.strip import place_name
from tdgbench.report.scene import scene_section
from tdgbench.report.scores import depth_priors, legend, published_section
from tdgbench.tables.assumptions import doubts_of
from tdgbench.tables.build import Tables
from tdgbench.tables.cell import Cell
from tdgbench.tables.grids import further_grid
from tdgbench.tables.palette import palette_notes
from tdgbench.tables.readings import changes_as_text

FILE = "report.html"


def write_report(tables: Tables) -> Path:
    """Write the page of an experiment from its files on disk; return its path. What is unusable there is n/a."""
    results, records = tables.results, tables.records
    scenes: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in results.finished:
        scenes.setdefault((cell.record.dataset, cell.record.scene, cell.record.split), []).append(cell)
    html = environment("tdgbench.report").get_template("page.html.j2").render(
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
