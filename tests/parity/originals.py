"""Fixtures of the parity tests: what the originals computed (see data/README.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

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
