"""Print the check of scenes: a table, or JSON."""

from __future__ import annotations

import json
from pathlib import Path

from rich.table import Table

from tdgbench.data.check.alignment import Offset
from tdgbench.data.check.scenes import SceneCheck
from tdgbench.terminal import console, printable, say
from tdgbench.text import one_line

COLORS = {"ok": "green", "missing": "yellow", "broken": "red"}


def print_table(root: Path, checks: list[SceneCheck]) -> None:
    """Print one row per scene, then problems and notes, one line each."""
    table = Table(title=f"Scenes in {printable(str(root))}", title_justify="left")
    for heading in ("scene", "layout", "views", "split", "size", "ch", "range", "masked", "edges, px", "status"):
        table.add_column(heading, overflow="fold")
    for check in checks:
        table.add_row(*_row(check))
    console().print(table)
    for check in checks:
        for problem in check.problems:
            say(f"{check.name}: {one_line(problem)}", check.status, COLORS[check.status])
        for note in check.notes:
            say(f"{check.name}: {one_line(note)}", "note", "dim")
    usable = sum(check.status == "ok" for check in checks)
    say(f"{usable} of {len(checks)} scenes can be used")


def _row(check: SceneCheck) -> list[str]:
    status = f"[{COLORS[check.status]}]{check.status}[/]"
    layout = one_line(check.layout).replace("[", r"\[")
    if not check.views:
        return [one_line(check.name).replace("[", r"\["), layout, *[""] * 7, status]
    views = str(check.views) if check.published is None else f"{check.views} of {check.published}"
    return [
        one_line(check.name).replace("[", r"\["),
        layout,
        views,
        f"{check.train} + {check.test}",
        ", ".join(f"{width}×{height}" for width, height in check.sizes[:2]) + (" …" if check.sizes[2:] else ""),
        str(check.channels),
        _range(check),
        "n/a" if check.masked is None else f"{100 * check.masked:.1f} %",
        f"{check.offset.px:.1f} ± {check.offset.spread:.1f}" if isinstance(check.offset, Offset) else "n/a",
        status,
    ]


def _range(check: SceneCheck) -> str:
    """Return what image values 0 and 1 are, in words."""
    if check.counts is not None:
        return f"counts {check.counts[0]} to {check.counts[1]}"
    return "n/a" if check.temperature is None else f"{check.temperature[0]:.1f} to {check.temperature[1]:.1f} °C"


def checks_as_json(root: Path, checks: list[SceneCheck], is_paper: bool) -> str:
    """Return the check as JSON with stable keys, described in docs/data.md."""
    return json.dumps(
        {
            "format": 2,
            "root": str(root),
            "scenes_of": "paper" if is_paper else "folder",
            "usable": all(check.status == "ok" for check in checks),
            "scenes": [_scene_json(check) for check in checks],
        },
        indent=1,
    )


def _scene_json(check: SceneCheck) -> dict[str, object]:
    offset = check.offset
    is_known = isinstance(offset, Offset)
    return {
        "name": check.name,
        "dataset": check.dataset,
        "status": check.status,
        "folder": check.folder or None,
        "layout": check.layout or None,
        "views": check.views,
        "views_published": check.published,
        "views_with_rgb": check.rgb,
        "train": check.train,
        "test": check.test,
        "sizes_px": [list(size) for size in check.sizes],
        "channels": check.channels,
        "temperature_degC": None if check.temperature is None else list(check.temperature),
        "counts": None if check.counts is None else list(check.counts),
        "masked_share": check.masked,
        "points": check.points,
        "edge_offset_px": offset.px if isinstance(offset, Offset) else None,
        "edge_offset": offset._asdict() if isinstance(offset, Offset) else None,
        "edge_offset_unknown": None if is_known or offset is None else offset.reason,  # type: ignore[union-attr]
        "problems": check.problems,
        "notes": check.notes,
    }
