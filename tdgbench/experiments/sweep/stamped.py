"""Leave the stamp of a finished sweep, by which the same command finds that nothing has changed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tdgbench.bench.outcome import COMPLETE, Outcome
from tdgbench.bench.plan import FILE as PLAN
from tdgbench.experiments.callback import ExperimentCallback
from tdgbench.experiments.stamp import Stamp, Told
from tdgbench.experiments.sweep.cells import PlannedCell, counted
from tdgbench.experiments.sweep.job import inputs_of_jobs
from tdgbench.filestate import States, merged, states_of
from tdgbench.tables.show import show
from tdgbench.tables.tables import Tables
from tdgbench.terminal import as_printed


class Written(NamedTuple):
    """Tables of a sweep, and the files that were written after them, in words."""

    tables: Tables
    files: dict[str, Path]


def states_of_cells(experiment: Path) -> States:
    """States of what tables and report are made from: the plan and all files of cells."""
    cells = experiment / "cells"
    return states_of([experiment / PLAN, *_files(cells)], trees=[cells])


def leave_stamp(
    experiment: Path, outcomes: list[Outcome], jobs: Path, cells: States, written: Written, summary: str
) -> None:  # fmt: skip
    """Write the stamp if every job has a result and all that its key depends on is known. Raises OSError.

    cells: from `states_of_cells`, before tables and report were written. summary: of outcomes that are all there.
    """
    command = ExperimentCallback.command
    if command is None or any(outcome.status not in COMPLETE for outcome in outcomes):
        return
    inputs = inputs_of_jobs(jobs, len(outcomes))
    results = merged([cells, states_of([*_files(written.tables.folder), *_pictures(written)])])
    if inputs is None or results is None:
        return
    lines = [Outcome("kept", outcome.title).line for outcome in outcomes]
    if len(outcomes) > 1:
        there = [PlannedCell("", "", "with a result")] * len(outcomes)
        lines.insert(0, f"{experiment.name}: {counted(there)}")
    text = "\n".join([_shown(written.tables), *files_in_words(written), summary])
    Stamp(command, inputs, results, Told(lines, text, written.tables.findings)).write(experiment)


def files_in_words(written: Written) -> list[str]:
    """A line for each kind of file, with its place."""
    return [f"{what}: {path}" for what, path in written.files.items()]


def _shown(tables: Tables) -> str:
    """The tables as a run without a terminal prints them."""
    return as_printed(lambda console: show(tables, console)).removesuffix("\n")


def _files(folder: Path) -> Iterable[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir())


def _pictures(written: Written) -> Iterable[Path]:
    return (path for path in written.files.values() if path.is_file())
