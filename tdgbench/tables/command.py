"""`tdgbench tables DIR ...`: rebuild the tables of results/<experiment> from disk, without training.

`tdgbench tables claims [DIR ...]`: test the paper's claims against its tables and against the cells of all these
experiments together; test every paper's averages against their rows.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.tables.between_papers import all_averages, between_papers
from tdgbench.tables.build import build_tables, write_claims
from tdgbench.tables.findings import claims_in_words
from tdgbench.tables.records import read_results
from tdgbench.tables.show import show, show_averages, show_claims, show_findings, show_papers, show_problems
from tdgbench.terminal import console, say
from tdgbench.text import one_line


def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 if a folder has no tables, or if something in it cannot be read."""
    parser = argparse.ArgumentParser(prog="tdgbench tables", description=__doc__)
    parser.add_argument("what", nargs="+", metavar="[claims] DIR", help="folders results/<experiment>")
    what = parser.parse_args(arguments).what
    if what[0] == "claims":
        return _claims([Path(folder) for folder in what[1:]])
    return max(_tables(Path(folder)) for folder in what)


def _tables(experiment: Path) -> int:
    try:
        tables = build_tables(experiment)
    except (ValueError, OSError) as error:
        return _refused(error)
    show(tables, console())
    show_findings(tables.findings)
    return int(bool(tables.problems))


def _claims(experiments: list[Path]) -> int:
    try:
        claims = write_claims(experiments)
    except (ValueError, OSError) as error:
        return _refused(error)
    show_claims(claims, console())
    show_papers(between_papers(), console())
    show_averages(all_averages(), console())
    problems = [problem for folder in experiments for problem in read_results(folder).problems]
    show_problems(problems, console())
    show_findings(claims_in_words(claims))
    return int(bool(problems))


def _refused(error: Exception) -> int:
    say(one_line(f"tdgbench tables: {error}"), stderr=True)
    return 1
