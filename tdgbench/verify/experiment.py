"""`tdgbench verify`: all cells of experiments."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import NamedTuple

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.known_classes import add_trust_arguments, known_classes, names_of, trust
from tdgbench.cells.paths import CAMERAS_FILE, RECORD_FILE, VIEWS_FILE, files_of
from tdgbench.cells.plan import read_plan
from tdgbench.cells.record import Record, no_records, record_files
from tdgbench.packs import opened_pack
from tdgbench.scenes.modalities import THERMAL
from tdgbench.tables.equal_data import equal_in_words, equal_scenes
from tdgbench.terminal import say
from tdgbench.text import meant, one_line
from tdgbench.verify.cell import check_cell, read_cell
from tdgbench.verify.problems import NotCheckedError, Problems
from tdgbench.verify.record_problems import place_problems
from tdgbench.verify.truth import data_problems, true_data

MOST_SHOWN = 500  # problems on the terminal
OF_A_CELL = (*files_of(THERMAL), VIEWS_FILE, CAMERAS_FILE)


class Verification(NamedTuple):
    """Number of cells, how many of them are finished, and every problem in words.

    checked: finished cells whose ground truth was compared with data. why_not: of the others, each reason once. equal:
    scenes with the test images of another one, in words. foreign: methods that are none of tdgbench's and whose renders
    were compared with those of their Gaussians alone. named: classes of methods and metrics that records name.
    not_made: how many problems are checks that could not be made.
    """

    cells: int
    finished: int
    problems: list[str]
    checked: int = 0
    why_not: tuple[str, ...] = ()
    equal: tuple[str, ...] = ()
    foreign: tuple[str, ...] = ()
    named: frozenset[str] = frozenset()
    not_made: int = 0

    @property
    def in_words(self) -> str:
        """The number of problems, and how many of them are no wrong number but a check that was not made.

        >>> Verification(2, 2, ["lpips cannot be computed again: no weights", "psnr is 9, not 8"], not_made=1).in_words
        '2 problems, 1 of them checks that could not be made'
        """
        m, n = len(self.problems), self.not_made
        some = f", {'all' if n == m else n} of them checks that could not be made" if n else ""
        return f"{m} problem{'s' * (m != 1)}{some}"

    @property
    def of_data(self) -> str:
        """What is known of the ground truth, in words."""
        if self.checked == self.finished:
            return "the ground truth was compared with the data"
        some = f"of {self.checked} of {self.finished} cells" if self.checked else "of no cell"
        return f"the ground truth was compared with the data {some}{'; '.join(['', *self.why_not])}"


def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 with a problem, without a finished cell, or without records."""
    description = "Check results against their records: hashes, renders, scores, counts; ground truth against the data."
    parser = argparse.ArgumentParser(prog="tdgbench verify", description=description)
    parser.add_argument("experiment", nargs="+", type=Path, help="folder results/<experiment>, or a pack")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the data sets, as data.root; built-in "
                        "scenes need none")  # fmt: skip
    parser.add_argument("--weights", type=Path, metavar="FILE", help="LPIPS's backbone, where scores are of a file")
    add_trust_arguments(parser)
    options, status = parser.parse_intermixed_args(arguments), 0
    for experiment in options.experiment:
        try:
            trust(options.config_dir, options.trust)
            with opened_pack(experiment) as folder:
                verified = verify(folder, options.data, options.weights)
        except (ValueError, OSError) as error:
            say(one_line(f"tdgbench verify: {error}"), stderr=True)
            status = 1
            continue
        for problem in verified.problems[:MOST_SHOWN]:
            say(one_line(problem), "problem:")
        if len(verified.problems) > MOST_SHOWN:
            say(f"{len(verified.problems) - MOST_SHOWN} more, which are not printed", "problem:")
        few = verified.finished < verified.cells
        unfinished = f", {verified.finished or 'none'} of them finished" if few else ""
        n = verified.cells
        say(one_line(f"{experiment}: {n} cell{'s' * (n != 1)}{unfinished}, {verified.in_words}"))
        if verified.finished:
            for sentence in (verified.of_data, *verified.equal):
                say(one_line(sentence), "data:")
        if verified.foreign:
            again = "are made again from the stored Gaussians, which takes none of its code"
            of = ", ".join(verified.foreign)
            say(one_line(f"renders of {of} {again}; what trained them is not checked"), "code:")
        for name in sorted({*options.trust} - verified.named):
            say(one_line(f"no cell has --trust {name}, so it was not run{meant(name, verified.named)}"), "code:")
        status |= bool(verified.problems) or not verified.finished
    return status


def verify(experiment: Path, data: Path | None = None, weights: Path | None = None) -> Verification:
    """Check every cell of an experiment. Raises ValueError if there are none.

    data: folder of the data sets, with which the ground truth is compared; built-in scenes need none. weights: as
    `verify_cell`.
    """
    records, lost = record_files(experiment), _without_record(experiment)
    if not records and not lost:
        raise no_records(experiment)
    of_plan, finished, checked, why_not = Problems(), 0, 0, dict[str, None]()
    sound: list[Record] = []
    foreign: dict[str, None] = {}
    named: set[str] = set()
    of_plan.read("its plan", read_plan, experiment)
    problems, not_made = of_plan.all, 0
    with true_data(data) as true:
        for folder in (path.parent for path in records):
            found = Problems()
            stated = found.read(RECORD_FILE, read_cell, folder)
            if stated is not None:
                cell, text = stated
                found.check("its folder", place_problems, cell)
                check_cell(cell, text, found, weights)
                named |= names_of(cell.record)
                if cell.record.status == "ok":
                    finished += 1
                    foreign |= dict.fromkeys([cell.record.method] if _is_foreign(cell) else [])
                    sound += [] if found.all else [cell.record]
                    try:
                        checked += found.check("its ground truth", data_problems, cell, true)
                    except NotCheckedError as reason:
                        why_not[str(reason)] = None
            name = folder.relative_to(experiment / "cells").as_posix()
            problems += [f"{name}: {problem}" for problem in found.all]
            not_made += found.not_made
    problems += [f"{folder.relative_to(experiment / 'cells').as_posix()}: {RECORD_FILE} is missing" for folder in lost]
    equal = tuple(equal_in_words(twin, first) for twin, first in equal_scenes(sound).items())
    return Verification(
        len(records), finished, problems, checked, tuple(why_not), equal, tuple(foreign), frozenset(named), not_made
    )


def _is_foreign(cell: CellFolder) -> bool:
    """Return whether the cell's method is none of tdgbench's, and rendering its Gaussians takes none of its code."""
    options = cell.record.setting("method.method")
    target = options.get("_target_") if isinstance(options, dict) else None
    return target not in known_classes("method") and not cell.has_parts


def _without_record(experiment: Path) -> list[Path]:
    """Return folders with files of a cell but no record, hidden folders excepted."""
    cells = experiment / "cells"
    # at this depth alone, as a method may be `renders`
    folders = {path.parent for name in OF_A_CELL for path in cells.glob(f"*/*/*/*/*/{name}")}
    visible = [f for f in sorted(folders) if not any(part.startswith(".") for part in f.relative_to(cells).parts)]
    return [folder for folder in visible if not os.path.lexists(folder / RECORD_FILE)]
