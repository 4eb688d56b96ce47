"""`tdgbench tables DIR ...`: rebuild the tables of results/<experiment> from disk, without training.

`tdgbench tables claims [DIR ...]`: test the paper's claims against its tables and against the cells of all these
experiments together; test every paper's averages against their rows.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.tables.between_papers import all_averages, between_papers
from tdgbench.tables.build import build_tables, write_claims
from tdgbench.tables.show import show, show_averages, show_claims, show_papers
from tdgbench.terminal import console, say


def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status."""
    parser = argparse.ArgumentParser(prog="tdgbench tables", description=__doc__)
    parser.add_argument("what", nargs="+", metavar="[claims] DIR", help="folders results/<experiment>")
    what = parser.parse_args(arguments).what
    try:
        if what[0] == "claims":
            show_claims(write_claims([Path(folder) for folder in what[1:]]), console())
            show_papers(between_papers(), console())
            show_averages(all_averages(), console())
            return 0
        for folder in what:
            show(build_tables(Path(folder)), console())
    except ValueError as error:
        say(f"tdgbench tables: {error}", stderr=True)
        return 1
    return 0
