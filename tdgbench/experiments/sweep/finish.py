"""After a sweep: tables, pictures, report, a summary of the cells, exit status."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig
from pydantic import TypeAdapter

from tdgbench.bench.failures import error_message
from tdgbench.bench.progress import SUCCESS, Outcome
from tdgbench.cells.plan import PLAN_FILE
from tdgbench.files import content_of, sha256_of, write_text
from tdgbench.resources import PACKAGE, conf_folder, paper_tables_folder
from tdgbench.terminal import console, copy_of_prints, print_again, say, show_findings

MADE = "made.json"


def finish(cfg: DictConfig, outcomes: list[Outcome]) -> None:
    """Write tables and pictures of all cells on disk; print a summary, one line per failure, and what was found.

    Cells that lack the same prior have one line. Raises SystemExit(1) if a cell failed, a scene was missing, or tables
    or report could not be written.
    """
    problem, findings = None, list[str]()
    try:
        findings = write_all(Path(cfg.results) / cfg.name)
    except Exception as error:  # the summary still has to come
        problem = error_message(error)
    unsuccessful = any(outcome.status not in SUCCESS for outcome in outcomes)
    say(count_outcomes(outcomes))
    for outcome in outcomes:
        if outcome.status == "failed":
            say(f"{outcome.title}: {outcome.message}", "failed:")
    without_prior = [outcome.message.splitlines()[0] for outcome in outcomes if outcome.status == "no prior"]
    for message in dict.fromkeys(without_prior):
        say(f"{_cells(without_prior.count(message))} without a depth prior: {message}", "failed:")
    show_findings(findings)
    if problem is not None:
        complete = "" if unsuccessful else "; the cells are complete"
        say(f"cannot write tables and report: {problem}{complete}", "error:")
    if problem is not None or unsuccessful:
        raise SystemExit(1)


def count_outcomes(outcomes: list[Outcome]) -> str:
    """Return the number of cells by outcome, in words.

    >>> count_outcomes([Outcome("ok", "tdg on a"), Outcome("kept", "tdg on b"), Outcome("kept", "tdg on c")])
    '1 cell run, 2 already there, 0 failed, 0 without data'
    """
    count = Counter(outcome.status for outcome in outcomes)
    parts = [
        f"{_cells(count['ok'])} run",
        f"{count['kept']} already there",
        f"{count['failed'] + count['no prior']} failed",
        f"{count['missing']} without data",
    ]
    return ", ".join(parts + ([f"{count['elsewhere']} running in another process"] if count["elsewhere"] else []))


def _cells(count: int) -> str:
    return f"{count} {'cell' if count == 1 else 'cells'}"


@dataclass(frozen=True)
class Made:
    """What was made of an experiment's cells. made_from: hash. outputs: hashes by path. printed: text."""

    made_from: str
    outputs: dict[str, str]
    printed: str
    findings: list[str]


_SCHEMA = TypeAdapter(Made)


def write_all(experiment: Path) -> list[str]:
    """Write and print tables, pictures and report of all cells on disk; return the findings in sentences.

    They stay as they are, and what was printed is printed again, where all that they are made from is what it was.
    """
    memory, made_from = experiment / "tables" / MADE, hash_of_sources(experiment)
    with suppress(OSError, ValueError):
        made = _SCHEMA.validate_json(content_of(memory))
        if made.made_from == made_from and made.outputs == _hashes(experiment, made.outputs):
            print_again(made.printed)
            return made.findings
    with copy_of_prints() as printed:
        findings, outputs = _write_outputs(experiment)
    made = Made(made_from, _hashes(experiment, outputs), "".join(printed), findings)
    write_text(memory, _SCHEMA.dump_json(made, indent=1).decode())
    return findings


def hash_of_sources(experiment: Path) -> str:
    """Return the hash of all that tables, pictures and report are made from: cells, plan, code, terminal.

    Size and time stand for the content of renders and models, whose hashes are in the records.
    """
    of_sweep = [experiment / PLAN_FILE, *sorted((experiment / "cells").rglob("*"))]
    code = {path for part in (PACKAGE, conf_folder(), paper_tables_folder()) for path in part.rglob("*")}
    digest = hashlib.sha256(repr((str(experiment), console().width, console().color_system)).encode())
    for path in filter(Path.is_file, [*of_sweep, *sorted(code)]):
        if path.suffix == ".pyc":
            continue
        content = f"{path.stat().st_size} {path.stat().st_mtime_ns}"
        if path in code or path.suffix in (".json", ".csv"):
            with suppress(OSError, ValueError):  # the tables say what cannot be read
                content = sha256_of(path, inside=None if path in code else experiment)
        digest.update(f"{path}\0{content}\0".encode("utf-8", "backslashreplace"))
    return digest.hexdigest()


def _hashes(experiment: Path, outputs: Iterable[str]) -> dict[str, str]:
    return {name: sha256_of(experiment / name, inside=experiment) for name in outputs}


def _write_outputs(experiment: Path) -> tuple[list[str], list[str]]:
    """Write and print tables, pictures and report; return the findings, and the paths of the outputs below it."""
    from tdgbench.present.strip import draw_strip  # Matplotlib, pandas and SciPy take a second
    from tdgbench.report.report_page import in_order, write_report
    from tdgbench.tables import methods
    from tdgbench.tables.build import build_tables
    from tdgbench.tables.columns import own_columns
    from tdgbench.tables.long_table import method_label
    from tdgbench.tables.show import show_tables

    tables = build_tables(experiment)
    show_tables(tables)
    say(f"tables: {tables.folder}")
    outputs = [path for path in tables.folder.iterdir() if path.suffix in (".csv", ".tex", ".txt")]
    strip = experiment / "strip.png"
    with own_columns(tables.results.plan):
        if draw_strip(in_order(tables.results), strip, lambda one: methods.label(method_label(one, with_init=True))):
            say(f"pictures: {strip}")
            outputs.append(strip)
    outputs.append(write_report(tables))
    say(f"report: {outputs[-1]}")
    return tables.findings, [path.relative_to(experiment).as_posix() for path in outputs]
