"""What a run keeps in a cell's folder: the record of a failure, and a result that a failure hid."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from tdgbench.cells.folder import hashes_below
from tdgbench.cells.key import as_json
from tdgbench.cells.paths import hidden_folder
from tdgbench.cells.record import Failure, Record, readable_record, record_files
from tdgbench.files import put_in_place, whole_folder


def write_failure(folder: Path, record: Record, failure: Failure) -> bool:
    """Replace the content of a cell's folder by the record of its failure; move a finished result to a hidden folder.

    A finished result stays in its place if the environment failed and the key is unknown or that of the result; returns
    whether the record was written. The caller must hold the cell's lock.
    """
    record.status, record.failure = "failed", Failure(**as_json(asdict(failure)))
    existing = readable_record(folder)
    if existing is not None and existing.status == "ok":
        if failure.of_environment and record.key in ("", existing.key):
            return False
        put_in_place(folder, hidden_folder(folder, existing.key))
    record.scores, record.train_scores, record.hashes, record.truth = {}, {}, {}, {}
    for name in ("config", "environment", "init_points", "prior"):
        setattr(record, name, as_json(getattr(record, name)))
    with whole_folder(folder) as part:
        record.write(part)
    return True


def restore(folder: Path, record: Record, existing: Record | None) -> bool:
    """Put the hidden result of the record's key back into a cell's folder, if its files are whole.

    existing: the record in the folder; a failure of the same key stays. The caller must hold the cell's lock.
    """
    hidden = hidden_folder(folder, record.key)
    kept = readable_record(hidden)
    if kept is None or kept.status != "ok" or kept.key != record.key:
        return False
    if existing is not None and existing.key == record.key:
        return False
    if not kept.hashes or not kept.hashes.items() <= hashes_below(hidden).items():
        return False
    put_in_place(hidden, folder)
    return True


def stored_in_words(experiment: Path) -> str:
    """Return what an interrupted run leaves on disk, in words: finished cells and the newest checkpoint."""
    records = [readable_record(path.parent) for path in record_files(experiment)]
    finished = sum(record is not None and record.status == "ok" for record in records)
    cells = f"{finished} finished {'cell' if finished == 1 else 'cells'}"
    written = []
    for path in (experiment / "checkpoints").glob("[!.]*.pt"):
        with suppress(OSError):  # another process has just removed it
            written.append(path.stat().st_mtime)
    state = f" and a checkpoint of {max(0, time.time() - max(written)):.0f} s ago" if written else ""
    return f"{experiment} keeps {cells}{state}; the same command goes on from there"
