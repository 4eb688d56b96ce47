"""What an interrupted run leaves on disk."""

from __future__ import annotations

import time
from pathlib import Path

from tdgbench.bench.record import read_record, record_files


def kept(experiment: Path) -> str:
    """Finished cells and the newest checkpoint of an experiment, in words."""
    finished = sum(_is_finished(path.parent) for path in record_files(experiment))
    cells = f"{finished} finished {'cell' if finished == 1 else 'cells'}"
    written = [path.stat().st_mtime for path in (experiment / "checkpoints").glob("[!.]*.pt")]
    state = f" and a checkpoint of {max(0, time.time() - max(written)):.0f} s ago" if written else ""
    return f"{experiment} keeps {cells}{state}; the same command goes on from there"


def _is_finished(folder: Path) -> bool:
    try:
        record = read_record(folder)
    except ValueError:
        return False
    return record is not None and record.status == "ok"
