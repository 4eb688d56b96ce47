"""Compare an experiment that was killed and resumed with an undisturbed one: same bytes, but for times."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from tdgbench.bench.record import FILE, Record, read_all
from tdgbench.report.page import write_report
from tdgbench.tables.build import build_tables

MAY_DIFFER = ("seconds", "peak_rss_mb", "peak_gpu_mb", "environment", "resumed", "notes")
PICTURE = re.compile(r"<svg.*?</svg>", re.DOTALL)  # matplotlib names its parts at random


def compare(calm: Path, killed: Path) -> list[str]:
    """Differences of a killed experiment from an undisturbed one, and its leftover files."""
    a, b = contents(calm), contents(killed)
    problems = [f"{title} is only in one of them" for title in sorted(set(a) ^ set(b))]
    for title in sorted(set(a) & set(b)):
        problems += [f"{title}: {name} differs" for name, value in a[title].items() if b[title][name] != value]
    problems += [f"{name} differs" for name in different_files(calm, killed)]
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
    # A recorded hash may be of a file that holds times; the files themselves are compared.
    content["hashes"] = {name: value for name, value in record.hashes.items() if Path(name).suffix != ".csv"}
    return content


def different_files(calm: Path, killed: Path) -> list[str]:
    """Files of cells, tables and report that differ in more than times.

    Tables and reports are built again from copies whose records and logs have equal times.
    """
    with tempfile.TemporaryDirectory() as scratch:
        a, b = (_with_equal_times(one, Path(scratch, name, one.name)) for one, name in ((calm, "a"), (killed, "b")))
        files = sorted({path.relative_to(one) for one in (a, b) for path in one.rglob("*") if path.is_file()})
        files = [name for name in files if name.name != FILE]
        lacking = [str(name) for one in (calm, killed) for name in files if not (one / name).is_file()]
        return lacking + [str(name) for name in files if _bytes(a / name) != _bytes(b / name)]


def _bytes(path: Path) -> bytes:
    if path.suffix == ".html":
        return PICTURE.sub("", path.read_text()).encode()
    return path.read_bytes() if path.exists() else b""


def _with_equal_times(experiment: Path, copy: Path) -> Path:
    """A copy of an experiment's cells with all times set to one second, and tables and report of them."""
    shutil.copytree(experiment / "cells", copy / "cells")
    shutil.copy(experiment / "experiment.json", copy)
    for path in (copy / "cells").rglob(FILE):
        content = json.loads(path.read_text())
        content |= {
            "peak_rss_mb": None,
            "resumed": [],
            "notes": [],
            "environment": {**content["environment"], "git": None},
        }
        content["seconds"] = dict.fromkeys(content["seconds"], 1.0)
        content["skips"] = [skip for skip in content["skips"] if skip["name"] != "prior"]
        path.write_text(json.dumps(content))
    for path in (copy / "cells").rglob("log.csv"):
        log = pd.read_csv(path, dtype=str, keep_default_na=False)
        log.assign(seconds="1").to_csv(path, index=False)
    write_report(copy, build_tables(copy))
    return copy
