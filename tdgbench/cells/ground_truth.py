"""Ground truth of test views: its hash in the record, the share that is masked, and whether that of two is the same.

A record's fingerprint of the data is its own word. What a cell was scored against are its stored pictures, so these
are compared.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from tdgbench.cells.folder import CellFolder, masked
from tdgbench.scenes import View
from tdgbench.scoring import to_8bit

MAX_DIFFERENT = 1e-3  # share of values that may differ by one of 255 levels: processors round differently


def truth_of(view: View) -> np.ndarray:
    """Return the ground truth of a view as it is scored, (H, W, C) uint8, 0 where masked."""
    return masked(to_8bit(view.thermal), view.valid)


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


def masked_share(views: Iterable[View]) -> float:
    """Return the share of the views' pixels at which no thermal value was measured."""
    masked, pixels = 0, 0
    for view in views:
        pixels += view.camera.width * view.camera.height
        masked += 0 if view.valid is None else int(np.count_nonzero(~view.valid))
    return masked / max(pixels, 1)


def masked_in_words(masked: Mapping[str, float]) -> str:
    """Return the shares of masked pixels of a record as a sentence; empty if nothing is masked.

    >>> masked_in_words({"train": 0.125, "test": 0.1})
    '12.5 % of the training and 10.0 % of the test pixels have no thermal value; they count in no loss and no score'
    >>> masked_in_words({"train": 0.0, "test": 0.0})
    ''
    """
    train, test = masked.get("train", 0.0), masked.get("test", 0.0)
    if not train and not test:
        return ""
    shares = f"{100 * train:.1f} % of the training and {100 * test:.1f} % of the test pixels"
    return f"{shares} have no thermal value; they count in no loss and no score"


def views_with_other_truth(a: CellFolder, b: CellFolder, views: Iterable[str]) -> list[str]:
    """Return the views whose ground truth differs between two cells. Pictures of equal bytes are not decoded.

    Raises ValueError or OSError for a picture that cannot be read.
    """
    unequal = [view for view in views if a.truth_bytes(view) != b.truth_bytes(view)]
    return [view for view in unequal if not same_truth(a.truth(view), b.truth(view))]


def truth_groups(cells: Iterable[CellFolder]) -> dict[Path, int]:
    """Return a number by a cell's folder, equal for cells of one scene with the same test views and ground truth.

    Cells whose pictures cannot be read, or that have none, have numbers of their own.
    """
    found: dict[tuple[object, ...], list[tuple[int, dict[str, np.ndarray]]]] = {}
    numbers, new = {}, itertools.count(1)
    for cell in cells:
        views = cell.views_with_truth()
        try:
            truth = {view: cell.truth(view) for view in views}
        except (OSError, ValueError):
            truth = {}
        known = found.setdefault((cell.record.dataset, cell.record.scene, *views), [])
        same = (n for n, other in known if truth and all(same_truth(truth[view], other[view]) for view in views))
        number = next(same, None)
        if number is None:
            number = next(new)
            known += [(number, truth)] if truth else []
        numbers[cell.folder] = number
    return numbers
