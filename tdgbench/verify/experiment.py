"""`tdgbench verify`: all cells of experiments."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

from tdgbench.bench.paths import files_of
from tdgbench.bench.plan import read_plan
from tdgbench.bench.record import FILE, no_records, record_files
from tdgbench.packs import opened_pack
from tdgbench.scenes.modalities import THERMAL
from tdgbench.terminal import say
from tdgbench.text import one_line
from tdgbench.verify.cell import read_cell, verify_cell
from tdgbench.verify.facts import place_problems
from tdgbench.verify.problems import Problems

OF_A_CELL = (*files_of(THERMAL), "views.csv", "cameras.json")


class Verification(NamedTuple):
    """Number of cells, how many of them are finished, and every problem in words."""

    cells: int
    finished: int
    problems: list[str]


def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 with a problem, without a finished cell, or without records."""
    description = "Check results against their records: hashes, renders, scores, counts."
    parser = argparse.ArgumentParser(prog="tdgbench verify", description=description)
    parser.add_argument("experiment", nargs="+", type=Path, help="folder results/<experiment>, or a pack")
    status = 0
    for experiment in parser.parse_args(arguments).experiment:
        try:
            with opened_pack(experiment) as folder:
                verified = verify(folder)
        except (ValueError, OSError) as error:
            say(one_line(f"tdgbench verify: {error}"), stderr=True)
            status = 1
            continue
        for problem in verified.problems:
            say(one_line(problem), "problem:")
        few = verified.finished < verified.cells
        unfinished = f", {verified.finished or 'none'} of them finished" if few else ""
        n, m = verified.cells, len(verified.problems)
        say(one_line(f"{experiment}: {n} cell{'s' * (n != 1)}{unfinished}, {m} problem{'s' * (m != 1)}"))
        status |= bool(verified.problems) or not verified.finished
    return status


def verify(experiment: Path) -> Verification:
    """Check every cell of an experiment. Raises ValueError if there are none."""
    records, lost = record_files(experiment), _without_record(experiment)
    if not records and not lost:
        raise no_records(experiment)
    of_plan, finished = Problems(), 0
    of_plan.read("its plan", read_plan, experiment)
    problems = of_plan.all
    for folder in (path.parent for path in records):
        found = Problems()
        cell = found.read(FILE, read_cell, folder)
        if cell is not None:
            finished += cell.record.status == "ok"
            found.check("its folder", place_problems, folder, cell.record)
            found.all += [problem for problem in verify_cell(folder) if problem not in found.all]
        name = folder.relative_to(experiment / "cells").as_posix()
        problems += [f"{name}: {problem}" for problem in found.all]
    problems += [f"{folder.relative_to(experiment / 'cells').as_posix()}: {FILE} is missing" for folder in lost]
    return Verification(len(records), finished, problems)


def _without_record(experiment: Path) -> list[Path]:
    """Return folders with files of a cell but no record, hidden folders excepted."""
    cells = experiment / "cells"
    # at this depth alone, as a method may be `renders`
    folders = {path.parent for name in OF_A_CELL for path in cells.glob(f"*/*/*/*/*/{name}")}
    visible = [f for f in sorted(folders) if not any(part.startswith(".") for part in f.relative_to(cells).parts)]
    return [folder for folder in visible if not (folder / FILE).exists() and not (folder / FILE).is_symlink()]
