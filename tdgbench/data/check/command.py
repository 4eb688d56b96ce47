"""`tdgbench data check DIR`."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from rich.table import Table
from rich.text import Text

from tdgbench.data.check.scenes import SceneCheck, check_scenes, find_place
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.layouts import LAYOUTS
from tdgbench.scenes.options import SPLITS
from tdgbench.terminal import console, printable, say
from tdgbench.text import one_line

COLORS = {"ok": "green", "doubtful": "yellow", "missing": "yellow", "broken": "red"}
USABLE = ("ok", "doubtful")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", type=Path, metavar="DIR", help="data.root: of the paper's data sets, or of scenes")
    parser.add_argument("--json", action="store_true", help="print JSON (keys: docs/data.md)")
    parser.add_argument("--split", choices=SPLITS, default=SPLITS[0], help="as data.split")


def run(arguments: argparse.Namespace) -> int:
    """Check the scenes in a folder. Exit status 0 if all that should be there are ok, else 1."""
    place = find_place(arguments.root, arguments.split)
    exists = is_there(arguments.root)
    if not exists:
        say(f"{arguments.root} does not exist", stderr=True)
        if not arguments.json:
            return 1
    checks = list(check_scenes(place, lambda name: say(name, "checking", "dim", stderr=True)))
    if exists and place.is_paper and all(check.status == "missing" for check in checks):
        say(f"no scene in {arguments.root}; a scene is a folder with one of (docs/data.md):", stderr=True)
        for layout in LAYOUTS.values():
            say(f"  {layout.title}: {layout.looks}", stderr=True)
        if not arguments.json and place.is_other:
            return 1  # somebody's own capture: a list of the paper's scenes would not help
        say("the paper's scenes:", stderr=True)
    if arguments.json:
        content = {
            "format": 4,
            "root": str(arguments.root),
            "scenes_of": "paper" if place.is_paper else "folder",
            "usable": all(check.status in USABLE for check in checks),
            "scenes": [asdict(check) for check in checks],
        }
        console().print(Text(json.dumps(content, indent=1)), soft_wrap=True)  # `say` would cut what is long
    else:
        print_table(arguments.root, checks)
    return 0 if all(check.status == "ok" for check in checks) else 1


def print_table(root: Path, checks: list[SceneCheck]) -> None:
    """Print one row per scene, then problems, doubts, notes and what was assumed, one line each."""
    table = Table(title=f"Scenes in {printable(str(root))}", title_justify="left")
    for heading in ("scene", "layout", "views", "split", "size", "ch", "range", "masked", "edges x, y, px", "status"):
        table.add_column(heading, overflow="fold")
    for check in checks:
        table.add_row(*_row(check))
    console().print(table)
    for check in checks:
        said: list[tuple[str, str]] = [(check.status, problem) for problem in check.problems]
        said += [("doubtful", doubt) for doubt in check.doubts]
        said += [("note", note) for note in check.notes]
        said += [("note", f"assumed {key}: {line}") for key, line in check.assumed.items()]
        for label, line in said:
            say(f"{check.name}: {one_line(line)}", label, COLORS.get(label, "dim"))
    usable, doubtful = (sum(check.status in among for check in checks) for among in (USABLE, USABLE[1:]))
    say(f"{usable} of {len(checks)} scenes can be used" + (f", {doubtful} of them with doubts" if doubtful else ""))


def _row(check: SceneCheck) -> list[str]:
    status = f"[{COLORS[check.status]}]{check.status}[/]"
    name, layout = (one_line(text).replace("[", r"\[") for text in (check.name, check.layout or ""))
    if not check.views:
        return [name, layout, *[""] * 7, status]
    offset, span, counts = check.edge_offset, check.temperature_degC, check.counts
    values = "n/a" if span is None else f"{span[0]:.1f} to {span[1]:.1f} °C"
    return [
        name,
        layout,
        str(check.views),
        f"{check.train} + {check.test}",
        ", ".join(f"{width}×{height}" for width, height in check.sizes_px[:2]) + (" …" if check.sizes_px[2:] else ""),
        str(check.channels),
        values if counts is None else f"counts {counts[0]} to {counts[1]}",
        "n/a" if check.masked_share is None else f"{100 * check.masked_share:.1f} %",
        "n/a" if offset is None else f"{offset.x:+.1f}, {offset.y:+.1f} ± {offset.spread:.1f}",
        status,
    ]
