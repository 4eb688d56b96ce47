"""Columns of a Gaussian's row of numbers: the layout that training and its gradients share."""

from __future__ import annotations

MEANS_AT, QUATS_AT, SCALES_AT, OPACITY_AT, COLORS_AT = 0, 3, 7, 10, 11
GEOMETRY_SIZES = [3, 4, 3, 1]  # columns of each parameter before the colours
LINE = 16  # floats of a cache line
LEAST_COLUMNS = 16  # of rows in training: they fill the widest register


def padded(columns: int) -> int:
    """Return the number of columns rounded up to whole cache lines, as of rows of gradients.

    >>> padded(COLORS_AT + 4), padded(COLORS_AT + 48)
    (16, 64)
    """
    return -(-columns // LINE) * LINE
