"""Fixtures of the parity tests: what the originals computed (see data/README.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

DATA = Path(__file__).parent / "data"


def original(name: str) -> dict[str, np.ndarray]:
    """The arrays of one fixture, by name."""
    with np.load(DATA / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def relative(ours, theirs) -> float:
    """Largest difference, as a share of the largest magnitude."""
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    assert ours.shape == theirs.shape
    return float(np.abs(ours - theirs).max() / max(np.abs(theirs).max(), 1e-30))


def matched(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """For each of our rows the one of theirs that it is; each is taken once."""
    assert len(ours) == len(theirs)
    cost = np.abs(ours[:, None].astype(np.float64) - theirs[None]).sum(axis=2)
    return linear_sum_assignment(cost)[1]


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference of a parameter; relative where it is larger than 1."""
    theirs = theirs[matched(ours, theirs)]
    return float((np.abs(ours - theirs) / np.maximum(1, np.abs(theirs))).max())
