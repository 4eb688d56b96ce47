"""Compare an experiment that was killed and resumed with an undisturbed one: same bytes, but for times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from tdgbench.cells.folder import CellFolder, hashes_of_content
from tdgbench.cells.record import Record, read_all, read_record, record_files
from tdgbench.tables.build import build_tables

MAY_DIFFER = ("seconds", "train_processor_seconds", "peak_rss_mb", "peak_gpu_mb", "environment", "resumed", "notes")
NOT_RESULTS = ("cache", "checkpoints", "hydra", "locks", "running")


def compare(calm: Path, killed: Path) -> list[str]:
    """Differences of a killed experiment from an undisturbed one, and its leftover files."""
    a, b = contents(calm), contents(killed)
    problems = [f"{title} is only in one of them" for title in sorted(set(a) ^ set(b))]
    for title in sorted(set(a) & set(b)):
        problems += [f"{title}: {name} differs" for name, value in a[title].items() if b[title][name] != value]
    problems += different_files(calm, killed)
    problems += [] if problems else wrong_tables(killed)
    leftovers = [*(killed / "cells").rglob(".*"), *(killed / "checkpoints").glob("*"), *killed.glob(".*")]
    return problems + [f"{path.relative_to(killed)} is a leftover" for path in leftovers]


def contents(experiment: Path) -> dict[str, dict[str, object]]:
    """Parts of the records that kills must not change, by cell.

    These are all but times, memory, machine, notes on checkpoints, and whether a prior was in the cache.
    """
    return {record.title: _content(record) for record in read_all(experiment)}


def _content(record: Record) -> dict[str, object]:
    content = {name: value for name, value in asdict(record).items() if name not in MAY_DIFFER}
    content["skips"] = [skip for skip in record.skips if skip["name"] != "prior"]
    content["hashes"] = hashes_of_content(record.hashes)
    return content


def different_files(calm: Path, killed: Path) -> Iterator[str]:
    """Files of cells that are not those of their records, whose hashes are compared; missing files."""
    for path in record_files(killed):
        record = read_record(path.parent)
        yield from () if record is None else CellFolder(path.parent, record).file_problems()
    yield from (f"{name} is only in one of them" for name in sorted({*_files(calm)} ^ {*_files(killed)}))


def wrong_tables(experiment: Path) -> list[str]:
    """Tables that are not those of the cells."""
    before = _tables(experiment)
    build_tables(experiment)
    return [f"{name} is not that of the cells" for name, text in _tables(experiment).items() if before[name] != text]


def _files(experiment: Path) -> list[str]:
    """Results but for locks and Hydra's own files."""
    names = [path.relative_to(experiment).as_posix() for path in experiment.rglob("*") if path.is_file()]
    return [name for name in names if name.split("/")[0] not in NOT_RESULTS]


def _tables(experiment: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (experiment / "tables").glob("*")}
