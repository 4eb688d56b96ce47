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
from tdgbench.bench.stored import hashes_of_content
from tdgbench.report.page import write_report
from tdgbench.tables.build import build_tables

MAY_DIFFER = ("seconds", "train_processor_seconds", "peak_rss_mb", "peak_gpu_mb", "environment", "resumed", "notes")
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
    content["hashes"] = hashes_of_content(record.hashes)
    return content


def different_files(calm: Path, killed: Path) -> list[str]:
    """Files of cells, tables and report that are missing or differ in more than times.

    If the cells agree, tables and reports are built again from copies whose records and logs have equal times.
    """
    with tempfile.TemporaryDirectory() as scratch:
        a, b = (_with_equal_times(one, Path(scratch, name, one.name)) for one, name in ((calm, "a"), (killed, "b")))
        different = _different(a, b)
        if not different:
            for one in (a, b):
                write_report(one, build_tables(one))
            different = _different(a, b)
            different += [str(n) for n in _files(a) for one in (calm, killed) if not (one / n).is_file()]
        return different


def _different(a: Path, b: Path) -> list[str]:
    """Files that differ or are only in one of two folders, but for records, whose content is compared."""
    names = [name for name in sorted({*_files(a), *_files(b)}) if name.name != FILE]
    return [str(name) for name in names if _bytes(a / name) != _bytes(b / name)]


def _files(folder: Path) -> list[Path]:
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


def _bytes(path: Path) -> bytes:
    if not path.exists():
        return b""
    return PICTURE.sub("", path.read_text(encoding="utf-8")).encode() if path.suffix == ".html" else path.read_bytes()


def _with_equal_times(experiment: Path, copy: Path) -> Path:
    """A copy of an experiment's plan and cells, with all times set to one second."""
    shutil.copytree(experiment / "cells", copy / "cells")
    shutil.copy(experiment / "experiment.json", copy)
    for path in (copy / "cells").rglob(FILE):
        content = json.loads(path.read_text(encoding="utf-8"))
        content |= {
            "peak_rss_mb": None,
            "resumed": [],
            "notes": [],
            "environment": {**content["environment"], "git": None},
        }
        content["seconds"] = dict.fromkeys(content["seconds"], 1.0)
        content["skips"] = [skip for skip in content["skips"] if skip["name"] != "prior"]
        path.write_text(json.dumps(content), encoding="utf-8")
    for path in (copy / "cells").rglob("log.csv"):
        log = pd.read_csv(path, dtype=str, keep_default_na=False)
        log.assign(**({"seconds": "1"} if "seconds" in log else {})).to_csv(path, index=False)
    return copy
