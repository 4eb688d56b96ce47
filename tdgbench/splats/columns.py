"""Columns of a Gaussian's parameters in a row, a layout that training states and gradients share."""

from __future__ import annotations

MEANS_AT, SCALES_AT, QUATS_AT, OPACITY_AT, COLORS_AT = 0, 3, 6, 10, 11
ALIGNMENT = 16  # floats: rows begin and end on cache lines


def padded(columns: int) -> int:
    """A number of columns rounded up to whole cache lines."""
    return -(-columns // ALIGNMENT) * ALIGNMENT
