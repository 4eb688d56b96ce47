"""What an interrupted run leaves on disk."""

from __future__ import annotations

import time
from pathlib import Path

from tdgbench.bench.record import record_files
from tdgbench.bench.stored import readable_record


def kept(experiment: Path) -> str:
    """Finished cells and the newest checkpoint of an experiment, in words."""
    records = [readable_record(path.parent) for path in record_files(experiment)]
    finished = sum(record is not None and record.status == "ok" for record in records)
    cells = f"{finished} finished {'cell' if finished == 1 else 'cells'}"
    written = [path.stat().st_mtime for path in (experiment / "checkpoints").glob("[!.]*.pt")]
    state = f" and a checkpoint of {max(0, time.time() - max(written)):.0f} s ago" if written else ""
    return f"{experiment} keeps {cells}{state}; the same command goes on from there"
