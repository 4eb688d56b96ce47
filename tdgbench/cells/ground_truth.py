"""The ground truth of a cell's test views: its hash in the record, and whether that of two cells is the same.

A record's fingerprint of the data is its own word. What a cell was scored against are its stored pictures, so these
are compared.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

import numpy as np

from tdgbench.cells.masks import has_mask, mask_path, read_mask
from tdgbench.cells.paths import files_of
from tdgbench.cells.read_files import MAX_PICTURE, read_named
from tdgbench.cells.record import Record
from tdgbench.files import content_of
from tdgbench.scenes import View
from tdgbench.scenes.modalities import THERMAL
from tdgbench.scoring import to_8bit

TARGETS = files_of(THERMAL).targets  # folder of a cell
MAX_DIFFERENT = 1e-3  # share of values that may differ by one of 255 levels: processors round differently


def truth_of(view: View) -> np.ndarray:
    """Return the ground truth of a view as it is scored, (H, W, C) uint8, 0 where masked."""
    return _masked(to_8bit(view.thermal), view.valid)


def stored_truth(folder: Path, view: str) -> np.ndarray:
    """Return `truth_of` a test view of a cell. Raises ValueError, naming the picture, if it cannot be read."""
    truth = read_named(folder, f"{TARGETS}/{view}.png")
    return _masked(truth, read_mask(folder, view, truth.shape[1::-1]) if has_mask(folder, view) else None)


def truth_hash(truth: np.ndarray) -> str:
    """Return SHA-256 of a ground truth (H, W, C) uint8.

    >>> truth_hash(np.zeros((1, 2, 1), np.uint8)) == truth_hash(np.zeros((2, 1, 1), np.uint8))
    False
    """
    return hashlib.sha256(f"{truth.shape}".encode() + np.ascontiguousarray(truth).tobytes()).hexdigest()


def truth_hashes(views: Iterable[View]) -> dict[str, str]:
    """Return the hash of each view's ground truth, by name, for a record."""
    return {view.name: truth_hash(truth_of(view)) for view in views}


def same_truth(a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether two ground truths are the same, but for rounding."""
    if a.shape != b.shape:
        return False
    off = np.abs(a.astype(np.int16) - b)
    return bool(off.max(initial=0) <= 1 and np.count_nonzero(off) <= MAX_DIFFERENT * off.size)


def views_with_truth(record: Record) -> list[str]:
    """Return the views of which a cell has a ground truth, sorted."""
    names = (PurePosixPath(name) for name in record.hashes)
    return sorted(name.stem for name in names if name.parent.as_posix() == TARGETS)


def views_with_other_truth(a: Path, b: Path, views: Iterable[str]) -> list[str]:
    """Return the views whose ground truth differs between two cells. Pictures of equal bytes are not decoded.

    Raises ValueError or OSError for a picture that cannot be read.
    """
    unequal = [view for view in views if _stored_bytes(a, view) != _stored_bytes(b, view)]
    return [view for view in unequal if not same_truth(stored_truth(a, view), stored_truth(b, view))]


def truth_groups(cells: Mapping[Path, Record]) -> dict[Path, int]:
    """Return a number by a cell's folder, equal for cells of one scene with the same ground truth.

    Cells whose pictures cannot be read are 0.
    """
    found: dict[tuple[object, ...], list[dict[str, np.ndarray]]] = {}
    numbers = {}
    for folder, record in cells.items():
        views = views_with_truth(record)
        key = record.dataset, record.scene, *views
        try:
            truth = {view: stored_truth(folder, view) for view in views}
        except (OSError, ValueError):
            numbers[folder] = 0
            continue
        known = found.setdefault(key, [])
        same = (i for i, other in enumerate(known) if all(same_truth(truth[view], other[view]) for view in views))
        number = next(same, len(known))
        if number == len(known):
            known.append(truth)
        numbers[folder] = number + 1
    return numbers


def _stored_bytes(folder: Path, view: str) -> list[bytes]:
    """Return the files that decide `stored_truth`."""
    paths = [folder / TARGETS / f"{view}.png", *([mask_path(folder, view)] if has_mask(folder, view) else [])]
    return [content_of(path, MAX_PICTURE, inside=folder) for path in paths]


def _masked(truth: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    return truth if valid is None else np.where(valid[..., None], truth, np.uint8(0))
