"""`report.html`: one file per experiment that opens from disk and needs no network."""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from tdgbench.bench.record import Record
from tdgbench.files import write_text
from tdgbench.report.published import published_section
from tdgbench.report.scene import scene_section
from tdgbench.report.scores import further_scores, legend, main_scores
from tdgbench.report.strip import place_name
from tdgbench.tables.build import Tables
from tdgbench.tables.cell import Cell, finished_cells
from tdgbench.tables.readings import changes_as_text

FILE = "report.html"


def write_report(experiment: Path, tables: Tables) -> Path:
    """Write the page of an experiment from its files on disk; return its path."""
    records = tables.records
    cells = finished_cells(experiment, records)
    scenes: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        scenes.setdefault((cell.record.dataset, cell.record.scene, cell.record.split), []).append(cell)
    environment = Environment(
        loader=PackageLoader("tdgbench.report", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    html = environment.get_template("page.html.j2").render(
        name=experiment.resolve().name,
        table=main_scores(tables),
        further=further_scores(tables),
        legend=legend(tables),
        published=published_section(tables),
        changes=None if tables.effects is None else changes_as_text(tables.effects),
        scenes=[scene_section(place[0], place_name(place, scenes), group) for place, group in scenes.items()],
        skips=[{"title": cell.record.title, "skips": cell.record.skips} for cell in cells],
        failures=[(r.title, r.failure.stage, r.failure.error) for r in records if r.failure is not None],
        environments=_environments(records),
    )
    path = experiment / FILE
    write_text(path, html)
    return path


def _environments(records: list[Record]) -> list[list[tuple[str, str]]]:
    """The distinct machines and versions that the cells ran on."""
    found = []
    for record in records:
        e = record.environment
        packages = ", ".join(f"{name} {version}" for name, version in e.get("packages", {}).items() if version)
        git = e.get("git") or {}
        commit = git.get("commit", "not from a checkout") + (" with changes" if git.get("dirty") else "")
        rows = [
            ("processor", f"{e.get('cpu')}, {e.get('cores')} cores, {e.get('threads')} threads"),
            ("GPU", ", ".join(f"{name} {value}" for name, value in (e.get("gpu") or {}).items()) or "none"),
            ("platform", f"{e.get('platform')}, Python {e.get('python')}"),
            ("packages", packages),
            ("commit", commit),
            ("metrics", record.convention),
        ]
        if rows not in found:
            found.append(rows)
    return found
