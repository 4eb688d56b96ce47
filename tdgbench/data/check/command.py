"""`tdgbench data check DIR`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.data.check.report import as_json, print_table
from tdgbench.data.check.scenes import SceneCheck, check_scenes, find_place
from tdgbench.data.check.table1_time import Table1Time, table1_time
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.splits import SPLITS
from tdgbench.terminal import say

LONGEST = 3600.0  # s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", type=Path, metavar="DIR", help="data.root: of the paper's data sets, or of scenes")
    parser.add_argument("--json", action="store_true", help="print JSON (keys: docs/data.md)")
    parser.add_argument("--split", choices=SPLITS, default=SPLITS[0], help="as data.split")
    parser.add_argument(
        "--time", type=_seconds, default=10.0, metavar="S",
        help="seconds of each of four timed trainings that tell how long Table 1 takes; 0: none",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Check the scenes in a folder. Exit status 0 if all that should be there can be used, else 1."""
    place = find_place(arguments.root, arguments.split)
    if not is_there(arguments.root):
        say(f"{arguments.root} does not exist", stderr=True)

    def begin(what: str) -> None:
        say(what, "checking", "dim", stderr=True)

    checks = list(check_scenes(place, begin))
    time = _time(checks, arguments.time, begin)
    if arguments.json:
        say(as_json(arguments.root, checks, time, place.is_paper))
    else:
        print_table(arguments.root, checks, time)
    return 0 if all(check.status == "ok" for check in checks) else 1


def _time(checks: list[SceneCheck], seconds: float, begin) -> Table1Time | str:
    """Time of Table 1, from the first usable scene that a training can be timed on."""
    if seconds == 0:
        return "time of Table 1: n/a (--time 0)"
    answer: Table1Time | str = "n/a: no usable scene to time a training on"
    for check in checks:
        if check.scene is not None:
            answer = table1_time(check.scene, seconds, begin)
            if isinstance(answer, Table1Time):
                return answer
    return f"time of Table 1: {answer}"


def _seconds(text: str) -> float:
    number = float(text)
    if not 0 <= number <= LONGEST:
        raise argparse.ArgumentTypeError(f"{text} is not in 0 to {LONGEST:g}")
    return number
