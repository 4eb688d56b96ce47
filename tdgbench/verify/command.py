"""Command line of `tdgbench verify`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.terminal import say
from tdgbench.text import one_line
from tdgbench.verify.experiment import verify_experiment


def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 with a problem, without a finished cell, or without records."""
    description = "Check results against their records: hashes, renders, scores, counts."
    parser = argparse.ArgumentParser(prog="tdgbench verify", description=description)
    parser.add_argument("experiment", nargs="+", type=Path, help="folder results/<experiment>")
    status = 0
    for experiment in parser.parse_args(arguments).experiment:
        try:
            found = verify_experiment(experiment)
        except (ValueError, OSError) as error:
            say(one_line(f"tdgbench verify: {error}"), stderr=True)
            status = 1
            continue
        for problem in found.problems:
            say(one_line(problem), "problem:")
        unfinished = "" if found.finished else ", none of them finished"
        say(one_line(f"{experiment}: {found.cells} cells{unfinished}, {len(found.problems)} problems"))
        status |= bool(found.problems) or not found.finished
    return status
