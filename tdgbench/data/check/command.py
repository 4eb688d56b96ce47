"""`tdgbench data check DIR`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.data.check.report import checks_as_json, print_table
from tdgbench.data.check.scenes import check_scenes, find_place
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.splits import SPLITS
from tdgbench.terminal import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `tdgbench data check`."""
    parser.add_argument("root", type=Path, metavar="DIR", help="data.root: of the paper's data sets, or of scenes")
    parser.add_argument("--json", action="store_true", help="print JSON (keys: docs/data.md)")
    parser.add_argument("--split", choices=SPLITS, default=SPLITS[0], help="as data.split")


def run(arguments: argparse.Namespace) -> int:
    """Check the scenes in a folder. Exit status 0 if all that should be there can be used, else 1."""
    place = find_place(arguments.root, arguments.split)
    if not is_there(arguments.root):
        say(f"{arguments.root} does not exist", stderr=True)
    checks = list(check_scenes(place, lambda name: say(name, "checking", "dim", stderr=True)))
    if arguments.json:
        say(checks_as_json(arguments.root, checks, place.is_paper))
    else:
        print_table(arguments.root, checks)
    return 0 if all(check.status == "ok" for check in checks) else 1
