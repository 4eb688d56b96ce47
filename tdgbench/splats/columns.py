"""Columns of a Gaussian's row of numbers: the layout that training and its gradients share."""

from __future__ import annotations

MEANS_AT, QUATS_AT, SCALES_AT, OPACITY_AT, COLORS_AT = 0, 3, 7, 10, 11
ALIGNMENT = 16  # floats: rows begin and end on cache lines


def padded(columns: int) -> int:
    """Return the number of columns rounded up to whole cache lines.

    >>> padded(COLORS_AT + 4), padded(COLORS_AT + 48)
    (16, 64)
    """
    return -(-columns // ALIGNMENT) * ALIGNMENT
