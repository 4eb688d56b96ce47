"""`python -m tdgbench.tables results/<experiment> …`: the tables again, from what is on disk.

`python -m tdgbench.tables claims [results/<experiment> …]`: the paper's claims, held against its own tables and
against the cells of all these experiments together, and every paper's averages, held against their rows.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console

from tdgbench.tables.between_papers import all_averages, between_papers
from tdgbench.tables.build import build_tables, write_claims
from tdgbench.tables.show import show, show_averages, show_claims, show_papers


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tdgbench.tables", description=__doc__)
    parser.add_argument("what", nargs="+", help="folders results/<experiment>; with `claims` before them, the claims")
    arguments = parser.parse_args()
    try:
        if arguments.what[0] == "claims":
            show_claims(write_claims([Path(folder) for folder in arguments.what[1:]]), Console())
            show_papers(between_papers(), Console())
            show_averages(all_averages(), Console())
            return 0
        for folder in arguments.what:
            show(build_tables(Path(folder)), Console())
    except ValueError as error:
        print(f"tdgbench.tables: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
