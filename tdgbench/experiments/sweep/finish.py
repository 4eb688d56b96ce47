"""After a sweep: tables, pictures, report, a summary of the cells, exit status."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from omegaconf import DictConfig

from tdgbench.bench.failures import error_message
from tdgbench.bench.progress import SUCCESS, Outcome
from tdgbench.present.strip import draw_strip
from tdgbench.report.report_page import in_order, write_report
from tdgbench.tables import methods
from tdgbench.tables.build import build_tables
from tdgbench.tables.show import show_findings, show_tables
from tdgbench.terminal import say


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


def write_all(experiment: Path) -> list[str]:
    """Write and print tables, pictures and report of all cells on disk; return the findings in sentences."""
    tables = build_tables(experiment)
    show_tables(tables)
    say(f"tables: {tables.folder}")
    if draw_strip(in_order(tables.results), experiment / "strip.png", methods.label):
        say(f"pictures: {experiment / 'strip.png'}")
    say(f"report: {write_report(tables)}")
    return tables.findings
