"""A cell's folder on disk: hashes of its files, its record or that of a failure, and a result that a failure hid."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from tdgbench.cells.key import as_json
from tdgbench.cells.paths import hidden_folder
from tdgbench.cells.record import FILE, Failure, Record, read_record, record_files
from tdgbench.files import put_in_place, sha256_of, whole_folder

OF_TIMES = ("log.csv",)  # hold times, so that they differ between equal trainings


def readable_record(folder: Path) -> Record | None:
    """Return the record in a folder; None if there is none, or if it is broken and the cell has to run again."""
    try:
        return read_record(folder)
    except ValueError:
        return None


def write_failure(folder: Path, record: Record, failure: Failure) -> None:
    """Replace the content of a cell's folder by the record of its failure; move a finished result to a hidden folder.

    A finished result stays in its place if the environment failed and the key is unknown or that of the result. The
    caller must hold the cell's lock.
    """
    record.status, record.failure = "failed", Failure(**as_json(asdict(failure)))
    existing = readable_record(folder)
    if existing is not None and existing.status == "ok":
        if failure.of_environment and record.key in ("", existing.key):
            return
        put_in_place(folder, hidden_folder(folder, existing.key))
    record.scores, record.train_scores, record.hashes, record.truth = {}, {}, {}, {}
    for name in ("config", "environment", "init_points", "prior"):
        setattr(record, name, as_json(getattr(record, name)))
    with whole_folder(folder) as part:
        record.write(part)


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
    if not kept.hashes or not kept.hashes.items() <= hashes(hidden).items():
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


def cell_files(folder: Path) -> dict[str, Path]:
    """Return everything below a cell's folder but its record and folders, by relative path. Links are not followed."""
    found = [path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir()]
    return {path.relative_to(folder).as_posix(): path for path in found if path != folder / FILE}


def hashes(folder: Path) -> dict[str, str]:
    """Return SHA-256 of every file below a cell's folder but its record, by relative path."""
    return {name: sha256_of(path, folder) for name, path in cell_files(folder).items()}


def hashes_of_content(recorded: dict[str, str]) -> dict[str, str]:
    """Return those of a record's hashes that equal trainings share.

    >>> hashes_of_content({"model.ply": "ab", "log.csv": "cd"})
    {'model.ply': 'ab'}
    """
    return {name: value for name, value in recorded.items() if name not in OF_TIMES}


def file_problems(folder: Path, recorded: dict[str, str], others: bool = True) -> Iterator[str]:
    """Yield files that are missing, unknown to the record, changed, or no files; those are never opened.

    others: whether files that the record does not know are problems.
    """
    actual = cell_files(folder)
    yield from (f"{name} is missing" for name in sorted(set(recorded) - set(actual)))
    yield from (f"{name} is not in the record" for name in sorted(set(actual) - set(recorded)) if others)
    for name in sorted(set(actual) & set(recorded)):
        try:
            if sha256_of(actual[name], folder) != recorded[name]:
                yield f"{name} has changed"
        except (OSError, ValueError) as error:
            yield f"{name} cannot be read: {error}"
