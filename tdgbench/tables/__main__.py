"""`python -m tdgbench.tables results/<experiment> …`: the tables again, from what is on disk."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console

from tdgbench.tables.build import build_tables
from tdgbench.tables.show import show


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tdgbench.tables", description=__doc__)
    parser.add_argument("experiment", nargs="+", type=Path, help="a folder results/<experiment>")
    arguments = parser.parse_args()
    for folder in arguments.experiment:
        try:
            show(build_tables(folder), Console())
        except ValueError as error:
            print(f"tdgbench.tables: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
